"""Small elements that the parts share: their ``el``, beside NiceGUI's ``ui``."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from nicegui import ui

from mvuav_ros.panel import sanitized
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.recordings.account import RecordingError

ElementT = TypeVar('ElementT', bound=ui.element)
_CHART = Path(__file__).parent.with_name('static') / 'chart.json'


def box(classes: str = '', tag: str = 'div') -> ui.element:
    """A plain element."""
    return ui.element(tag).classes(classes)


def text(words: object, classes: str = '', tag: str = '') -> ui.label:
    """Words, shown as they are whatever they contain."""
    label = ui.label(sanitized.words(words, sanitized.LONGEST_DESCRIPTION)).classes(classes)
    if tag:
        label.tag = tag
    return label


def name_rejected(label: ui.label, what: str, reasons: Mapping[str, str]) -> None:
    """Say which files are left out, and why; nothing where there are none."""
    said = f'{what}: {"; ".join(map(": ".join, reasons.items()))}'
    label.set_text(sanitized.words(said, sanitized.LONGEST_DESCRIPTION))
    label.set_visibility(bool(reasons))


def set_props(element: ElementT, **props: object) -> ElementT:
    """Set attributes to values that may be anything, as ``props`` itself would read them as markup.

    A ``_`` in a name stands for ``-``. Nothing is sent where they have these values already.
    """
    for name, value in props.items():
        if element.props.get(name.replace('_', '-')) != value:
            element.props[name.replace('_', '-')] = value
    return element


def set_class(element: ui.element, name: str, on: bool) -> None:
    """Give an element a class, or take it away."""
    element.classes(add=name) if on else element.classes(remove=name)


def button(
    words: str, on_click: Callable[..., Any] | None, icon: str = '', *, main: bool = False
) -> ui.button:
    """A button; the main one of its group is filled."""
    made = ui.button(words, on_click=on_click, icon=icon or None)
    return made.props('unelevated dense' if main else 'outline dense').classes('q-px-sm')


def icon_button(icon: str, words: str, on_click: Callable[..., Any] | None) -> ui.button:
    """A small button with a tooltip, which is also its name for who cannot see it."""
    made = ui.button(icon=icon, on_click=on_click).props('flat round dense size=sm')
    with set_props(made, aria_label=words):
        ui.tooltip(words).props('delay=400')
    return made


def slider(label: str, on_move: Callable[[int], object], unit: str = '') -> ui.element:
    """The browser's own slider; ``on_move`` gets its position.

    Quasar's puts the keyboard's focus on an element without a role. ``static/live.js`` places the
    thumb and writes what it speaks.
    """
    made = set_props(box('range', 'input'), aria_label=label, data_unit=unit)
    return made.props('type=range min=0 step=1').on(
        'input',
        lambda event: on_move(int(event.args)),
        js_handler='(e) => emit(e.target.value)',
        throttle=0.05,
    )


def choice(options: Any, label: str, value: Any = None, **more: Any) -> ui.select:
    """A menu to choose from."""
    made = ui.select(options, value=value, label=label, **more)
    return set_props(made.props('outlined dense options-dense'), aria_label=label)


def empty(title: str, words: str, *, card: bool = False) -> None:
    """What is shown where there is nothing yet."""
    with box('card empty' if card else 'empty'):
        text(title, tag='strong')
        text(words)


@contextmanager
def dialog(title: str) -> Iterator[ui.dialog]:
    """A dialog, opened; it is gone for good when it is closed."""
    with ui.dialog() as made, ui.card().classes('card'):
        set_props(made, aria_label=sanitized.words(title))
        text(title, 'title', tag='h2')
        yield made
    made.on('hide', made.delete)
    made.open()


async def confirmed(question: str, yes: str) -> bool:
    """Whether the user says yes."""
    with dialog(question) as asking, box('line'):
        button(yes, lambda: asking.submit(True), main=True)
        button('Cancel', asking.close)
    return bool(await asking)


def notify(words: str, *, bad: bool = False) -> None:
    """A short message at the bottom."""
    shown = sanitized.words(words)
    ui.notify(shown, type='negative' if bad else None, position='bottom', timeout=5000)


@contextmanager
def errors_notified() -> Iterator[None]:
    """Show what is refused, or cannot be read or written; the rest of the block is left out."""
    try:
        yield
    except (sanitized.NameRefusedError, ParameterError, RecordingError, OSError) as error:
        notify(str(error), bad=True)


def sheet(label: str, heads: Sequence[str]) -> ui.table:
    """A table of text for `fill`; without a line of headings where all are empty."""
    # A region that scrolls must be reached by the keyboard.
    with set_props(box('sheet').props('tabindex=0 role=region'), aria_label=label):
        columns = [
            {'name': str(i), 'label': head, 'field': str(i), 'align': 'right' if i else 'left'}
            for i, head in enumerate(heads)
        ]
        table = ui.table(rows=[], columns=columns, row_key='row').props('flat dense')
    return set_props(table, hide_header=not any(heads))


def fill(table: ui.table, rows: Iterable[Sequence[object]]) -> None:
    """Show these rows; nothing is sent where they are shown already."""
    shown = [
        {'row': number, **{str(i): sanitized.words(cell) for i, cell in enumerate(row)}}
        for number, row in enumerate(rows)
    ]
    if shown != table.rows:
        table.rows = shown


def axes(title: str, unit: str, categories: Sequence[str] | None = None) -> Any:
    """An ECharts chart without curves, over categories, or over the last seconds without them.

    It can be read on light and dark and saved as an image. Its tooltips are rich text, not HTML:
    names in them come from bags and files.
    """
    options = json.loads(_CHART.read_text())
    options['title']['text'] = f'{title} [{unit}]' if unit else title
    if categories is None:
        options['xAxis'] |= {'type': 'value', 'min': -30, 'max': 0, 'interval': 10}
        options['xAxis']['axisLabel']['formatter'] = '{value} s'
    else:
        options['xAxis']['data'] = list(categories)
    return options

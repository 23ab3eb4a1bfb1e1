"""Small elements that the parts share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nicegui import ui

COLORS = ('#3d8fd6', '#e0752d', '#17a07a', '#c77bab', '#c99700', '#5bb8e8', '#8a6fc0', '#a3793f')


class LocalSlider(ui.slider):
    """A slider that follows the hand, not what the server heard of it a while ago."""

    LOOPBACK = False


def box(classes: str = '', tag: str = 'div') -> ui.element:
    """A plain element."""
    return ui.element(tag).classes(classes)


def text(words: object, classes: str = '', tag: str = '') -> ui.label:
    """Words, shown as they are whatever they contain."""
    label = ui.label(str(words)).classes(classes)
    if tag:
        label.tag = tag
    return label


def button(
    words: str, on_click: Callable[..., Any], icon: str = '', *, main: bool = False
) -> ui.button:
    """A button; the main one of its group is filled."""
    made = ui.button(words, on_click=on_click, icon=icon or None)
    return made.props('unelevated dense' if main else 'outline dense').classes('q-px-sm')


def icon_button(icon: str, words: str, on_click: Callable[..., Any]) -> ui.button:
    """A small button with a tooltip, which is also its name for who cannot see it."""
    made = ui.button(icon=icon, on_click=on_click).props('flat round dense size=sm')
    made.props['aria-label'] = words
    with made:
        ui.tooltip(words)
    return made


def empty(title: str, words: str) -> None:
    """What is shown where there is nothing yet."""
    with box('empty'):
        text(title, tag='strong')
        text(words)


def ask_to_delete(question: str, delete: Callable[[], None]) -> None:
    """Call ``delete`` if the user says so."""
    with ui.dialog() as dialog, ui.card().classes('card'):
        text(question, 'title')

        def confirmed() -> None:
            # First: what delete() draws anew may hold the dialog.
            dialog.close()
            delete()

        with box('line'):
            button('Delete', confirmed, main=True)
            button('Keep', dialog.close)
    dialog.on('hide', dialog.delete)
    dialog.open()


def tell(words: str, *, bad: bool = False) -> None:
    """A short message at the bottom."""
    ui.notify(words, type='negative' if bad else None, position='bottom', timeout=4000)


def sheet(rows: list[list[str]]) -> None:
    """A table of text without a head."""
    with box('scroll'), box('sheet', 'table'), box(tag='tbody'):
        for row in rows:
            with box(tag='tr'):
                for cell in row:
                    text(cell, tag='td')


def axes(
    title: str, unit: str, *, seconds: bool = False, categories: list[str] | None = None
) -> Any:
    """An empty ECharts chart that can be read on light and dark."""
    grey, line = '#8592a1', 'rgba(133, 146, 161, .28)'
    label = {'color': grey, 'fontSize': 11}
    rule = {'lineStyle': {'color': line}}
    x: dict[str, Any] = {
        'axisLabel': label,
        'axisLine': {**rule, 'onZero': False},
        'splitLine': {'show': False},
    }
    if seconds:
        x |= {'type': 'value', 'min': -30, 'max': 0, 'interval': 10}
        x['axisLabel'] = {**label, 'formatter': '{value} s'}
    else:
        x |= {'type': 'category', 'data': categories or []}
        x['axisLabel'] = {**label, 'hideOverlap': True}
    name = f'{title} [{unit}]' if unit else title
    return {
        'animation': False,
        'color': list(COLORS),
        'title': {
            'text': name,
            'left': 12,
            'top': 10,
            'textStyle': {'color': grey, 'fontSize': 12, 'fontWeight': 600},
        },
        'grid': {'left': 56, 'right': 16, 'top': 40, 'bottom': 48},
        'legend': {
            'bottom': 6,
            'type': 'scroll',
            'textStyle': label,
            'itemWidth': 10,
            'icon': 'roundRect',
            'itemHeight': 10,
            'pageTextStyle': label,
        },
        # Rich text, not HTML: names in it come from bags and files.
        'tooltip': {'trigger': 'axis', 'renderMode': 'richText', 'confine': True},
        'xAxis': x,
        'yAxis': {
            'type': 'value',
            'scale': True,
            'axisLine': {'show': False},
            'axisTick': {'show': False},
            'axisLabel': label,
            'splitLine': rule,
            'splitNumber': 4,
        },
        'series': [],
    }

"""Choosing, loading, saving and comparing named sets."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from nicegui import ui

from mvuav_ros.panel.controls import value_text
from mvuav_ros.panel.names import NameRefusedError
from mvuav_ros.panel.page.context import Page
from mvuav_ros.panel.page.elements import ask_to_delete, box, button, icon_button, tell, text
from mvuav_ros.panel.sets import differences
from mvuav_ros.parameters.declaration import ParameterError, Value

LIVE = 'live values'
Load = Callable[[dict[str, Value]], Awaitable[dict[str, str]]]


class SetBar:
    """The bar above the parameters."""

    def __init__(self, page: Page, load: Load, changed: Callable[[], None]) -> None:
        """Make the bar in the place where elements now go.

        Args:
            page: whose node and set it is about.
            load: gives values to the node; returns what it refused.
            changed: called when another set was chosen or a set has changed.
        """
        self._page, self._load, self._changed = page, load, changed
        self._values: dict[str, object] = {}
        self._loaded_name = ''
        with box('sets'):
            with box('line'):
                self._choice = ui.select([], label='Set', on_change=self._choose)
                self._choice.props('outlined dense options-dense').classes('grow')
                self._choice.props['aria-label'] = 'Set'
                button('Load', self._load_chosen)
                button('Save', self._ask_name)
                icon_button('compare_arrows', 'Compare two sets', self._compare)
                self._delete = icon_button('delete_outline', 'Delete the set', self._ask_delete)
            self._match = text('', 'match').props('role=status')
        self._list()

    @property
    def _kind(self) -> str:
        return self._page.node.kind if self._page.node is not None else ''

    def _list(self) -> None:
        names = self._page.services.sets.names(self._kind)
        if self._page.chosen_set not in names:
            self._page.chosen_set = ''
        self._choice.set_options(names, value=self._page.chosen_set or None)
        self._read()

    def _choose(self, event: Any) -> None:
        if (event.value or '') != self._page.chosen_set:
            self._page.chosen_set = event.value or ''
            self._read()
            self._changed()

    def _read(self) -> None:
        name = self._page.chosen_set
        self._values = self._values_of(name) if name else {}
        built_in = not name or self._page.services.sets.is_built_in(name)
        self._delete.set_enabled(not built_in)

    def _values_of(self, name: str) -> dict[str, object]:
        if name == LIVE:
            return dict(self._page.own_values())
        try:
            return self._page.services.sets.load(name, self._kind)
        except (ParameterError, NameRefusedError) as error:
            tell(str(error), bad=True)
            return {}

    def refresh(self, live: Mapping[str, object]) -> dict[str, object]:
        """Say whether the live values are the chosen set's; returns that set."""
        name = self._page.chosen_set
        count = len(differences(self._values, live))
        if not name:
            words = 'Choose a set to load it, or to see what differs from it.'
        elif count:
            words = f'{count} live value{"s differ" if count > 1 else " differs"} from {name}'
        else:
            words = f'The live values are those of {name}.'
        self._match.set_text(words)
        self._match.classes(add='differs') if count else self._match.classes(remove='differs')
        return self._values

    async def _load_chosen(self) -> None:
        name = self._page.chosen_set
        if not name:
            tell('Choose a set first.')
            return
        self._read()
        values: Any = self._values
        refused = await self._load(values)
        if refused:
            tell(f'{len(refused)} values of {name} were refused; see there', bad=True)
        else:
            tell(f'{name} is loaded')

    def _ask_name(self) -> None:
        sets = self._page.services.sets
        name = self._page.chosen_set
        with ui.dialog() as dialog, ui.card().classes('card'):
            text('Save the live values as a set', 'title')
            field = ui.input('Name', value='' if sets.is_built_in(name) else name)
            field.props('outlined dense autofocus').style('width: 280px; max-width: 100%')
            text('An ordinary ROS 2 parameter file, in', 'small soft')
            text(sets.folder, 'small soft number').style('overflow-wrap: anywhere')

            def save() -> None:
                if self._save(field.value or ''):
                    dialog.close()

            field.on('keydown.enter', save)
            with box('line'):
                button('Save', save, main=True)
                button('Cancel', dialog.close)
        dialog.on('hide', dialog.delete)
        dialog.open()

    def _save(self, name: str) -> bool:
        try:
            self._page.services.sets.save(name, self._kind, self._page.own_values())
        except (NameRefusedError, OSError) as error:
            tell(str(error), bad=True)
            return False
        self._page.chosen_set = name.strip()
        self._list()
        self._changed()
        tell(f'{name.strip()} is saved')
        return True

    def _ask_delete(self) -> None:
        name = self._page.chosen_set

        def delete() -> None:
            self._page.services.sets.delete(name)
            self._list()
            self._changed()

        ask_to_delete(f'Delete the set {name}?', delete)

    def _compare(self) -> None:
        names = [LIVE, *self._page.services.sets.names(self._kind)]
        with (
            ui.dialog() as dialog,
            ui.card().classes('card').style('width: 640px; max-width: 96vw'),
        ):
            text('Compare two sets', 'title')
            with box('line').style('width: 100%'):
                left = ui.select(names, value=LIVE).props('outlined dense').classes('grow')
                chosen = self._page.chosen_set or names[min(1, len(names) - 1)]
                right = ui.select(names, value=chosen).props('outlined dense').classes('grow')
            whole = ui.switch('Also what is equal').props('dense')
            place = box('scroll').style('width: 100%; max-height: 55vh; overflow: auto')

            def show() -> None:
                place.clear()
                with place:
                    self._comparison(left.value, right.value, all_of_them=bool(whole.value))

            for each in (left, right, whole):
                each.on_value_change(show)
            show()
            button('Close', dialog.close)
        dialog.on('hide', dialog.delete)
        dialog.open()

    def _comparison(self, left: str, right: str, *, all_of_them: bool) -> None:
        found = differences(self._values_of(left), self._values_of(right), all_of_them=all_of_them)
        if not found:
            text('No parameter differs.', 'soft')
            return
        with box('sheet', 'table'):
            with box(tag='tr'):
                for head in ('parameter', left, right):
                    text(head, tag='th')
            for each in found:
                with box(tag='tr').style('font-weight: 600' if each.differs else ''):
                    text(each.name, tag='td')
                    text(value_text(each.left), tag='td')
                    text(value_text(each.right), tag='td')

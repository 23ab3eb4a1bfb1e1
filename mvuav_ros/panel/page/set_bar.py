"""Choosing, loading, saving, exchanging and comparing named sets."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from nicegui import ui

from mvuav_ros.panel import sanitized
from mvuav_ros.panel.controls import value_text
from mvuav_ros.panel.live_nodes import LiveNode
from mvuav_ros.panel.page import elements as el
from mvuav_ros.panel.page.context import Load, Page
from mvuav_ros.panel.sets import MAX_SET_BYTES, differences
from mvuav_ros.parameters.declaration import Value


class SetBar:
    """The bar above a node's parameters.

    ``values`` are the chosen set's. ``load`` gives values to the node, ``changed`` is called when
    another set was chosen.
    """

    def __init__(self, page: Page, node: LiveNode, load: Load, changed: Callable[[], None]) -> None:
        self._page, self._node, self._load, self._changed = page, node, load, changed
        with el.box('sets'):
            with el.box('line'):
                self._choice = el.choice([], 'Set', on_change=self._choose).classes('grow')
                el.button('Load', self._load_chosen)
                el.button('Save', self._ask_name)
                with el.icon_button('more_vert', 'More about sets', None), ui.menu():
                    self._download = ui.menu_item('Download the set', self._send_file)
                    ui.menu_item('Upload a set', self._ask_file)
                    self._delete = ui.menu_item('Delete the set', self._delete_chosen)
            self._match = el.text('', 'match').props('role=status')
            self._rejected = el.text('', 'small soft breaks')
        self.reload()

    def reload(self) -> None:
        """After a set was saved, taken in or deleted."""
        names = self._page.services.sets.names(self._node.kind)
        if self._page.chosen_set not in names:
            self._page.chosen_set = ''
        self._choice.set_options(names, value=self._page.chosen_set or None)
        el.name_rejected(self._rejected, 'Not usable', self._page.services.sets.rejected)
        self._read()

    def _choose(self, event: Any) -> None:
        if (event.value or '') != self._page.chosen_set:
            self._page.chosen_set = event.value or ''
            self._read()
            self._changed()

    def _read(self) -> None:
        name = self._page.chosen_set
        self.values: Mapping[str, Value] = {}
        if name:
            with el.errors_notified():
                self.values = self._page.services.sets.load(name, self._node.kind)
        self._download.set_enabled(bool(name))
        self._delete.set_enabled(bool(name) and name not in self._page.services.sets.built_in)

    def compare(self) -> dict[str, str]:
        """Say whether the live values are the chosen set's; returns the set's that differ."""
        name = self._page.chosen_set
        differing = differences(self.values, self._node.own_values)
        words = 'Choose a set to load it, or to see what differs from it.'
        if differing:
            differ = 'value differs' if len(differing) == 1 else 'values differ'
            words = f'{len(differing)} live {differ} from {name}'
        elif name:
            words = f'The live values are those of {name}.'
        unknown = [each for each in self.values if each not in self._node.values]
        said = f'{words} The node has no {", ".join(unknown)}, as {name} has.' if unknown else words
        self._match.set_text(sanitized.words(said))
        el.set_class(self._match, 'differs', bool(differing or unknown))
        return {each: f'{name}: {value_text(own)}' for each, (own, _) in differing.items()}

    async def _load_chosen(self) -> None:
        name = self._page.chosen_set
        if not name:
            el.notify('Choose a set first.', bad=True)
            return
        self._read()
        await self._load(self.values, name)

    def _ask_name(self) -> None:
        sets, name = self._page.services.sets, self._page.chosen_set

        async def save() -> None:
            new = (field.value or '').strip()
            is_others = new != name and new in self._choice.options and new not in sets.built_in
            if is_others and not await el.confirmed(f'Replace the set {new}?', 'Replace'):
                return
            with el.errors_notified():
                save_set(self._page, self._node, new)
                asking.close()

        with el.dialog('Save the live values as a set') as asking:
            field = ui.input('Name', value='' if name in sets.built_in else name)
            field.props('outlined dense autofocus').style('width: 280px; max-width: 100%')
            field.on('keydown.enter', save)
            el.text('An ordinary ROS 2 parameter file, in', 'small soft')
            el.text(sets.folder, 'small soft number breaks')
            with el.box('line'):
                el.button('Save', save, main=True)
                el.button('Cancel', asking.close)

    async def _delete_chosen(self) -> None:
        name, services = self._page.chosen_set, self._page.services
        if await el.confirmed(f'Delete the set {name}?', 'Delete'):
            with el.errors_notified():
                services.sets.delete(name)
            services.sets_changed.emit()

    def _send_file(self) -> None:
        name = self._page.chosen_set
        with el.errors_notified():
            content = self._page.services.sets.content(name)
            ui.download.content(content, f'{name}.yaml', 'application/yaml')

    def _ask_file(self) -> None:
        services, too_large = self._page.services, f'the file has more than {MAX_SET_BYTES} bytes'

        async def take(event: Any) -> None:
            name = Path(event.file.name).stem
            with el.errors_notified():
                kinds = services.sets.add(name, await event.file.read())
                if self._node.kind in kinds:
                    self._page.chosen_set = name.strip()
                services.sets_changed.emit()
                el.notify(f'{name} is uploaded for {" and ".join(kinds)}')
                asking.close()

        with el.dialog('Upload a set') as asking:
            el.text('A ROS 2 parameter file (.yaml) of our nodes.', 'small soft')
            ui.upload(
                label='Choose a file or drop one here',
                auto_upload=True,
                max_file_size=MAX_SET_BYTES,
                on_upload=take,
                on_rejected=lambda: el.notify(too_large, bad=True),
            ).props('accept=.yaml,.yml flat bordered').style('width: 100%')
            el.button('Cancel', asking.close)


def save_set(page: Page, node: LiveNode, name: str) -> None:
    """Save a node's values as a set; errors as those of `SetStore.save`."""
    page.services.sets.save(name, node.kind, node.own_values)
    page.chosen_set = name.strip()
    page.services.sets_changed.emit()
    el.notify(f'{name.strip()} is saved')

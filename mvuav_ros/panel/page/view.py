"""The whole page, for one browser tab: its head, and the parts below."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from typing import Any

from nicegui import Client, ui

from mvuav_ros.panel.live_nodes import LiveNode
from mvuav_ros.panel.page import elements as el
from mvuav_ros.panel.page.context import Page, Services
from mvuav_ros.panel.page.head import Head, show_keys
from mvuav_ros.panel.page.parameters import Parameters
from mvuav_ros.panel.page.readout import PoseScene, Results, make_readout
from mvuav_ros.panel.page.run_list import Runs
from mvuav_ros.panel.page.tiles import Images
from mvuav_ros.parameters.declaration import Value
from mvuav_ros.processing.registry import PROCESSORS

_PARTS = {
    'images': 'Images',
    'results': 'Results',
    'runs': 'Recordings',
    'parameters': 'Parameters',
}


class PanelView:
    """Puts the parts together, for a browser tab that is connected, and passes on what changes."""

    def __init__(self, services: Services, client: Client, kept: MutableMapping[str, Any]) -> None:
        self._page, self._client = Page(services, kept, self._selected), client
        self._parameters: Parameters | None = None
        self._results: Results | None = None
        # By node: what they are made of, too.
        self._parts: dict[str, tuple[object, Results | None, Parameters | None]] = {}
        with el.box('panel') as self._root:
            self._head = Head(self._page)
            with el.box('body'):
                self._preview = make_readout()
                with ui.tabs(on_change=self._show_part) as self._tabs:
                    for key, words in _PARTS.items():
                        ui.tab(key, words).classes(f'tab {key}')
                self._tabs.props(
                    'dense no-caps inline-label align=left aria-label="Parts of the panel"'
                )
                with ui.tab_panels(self._tabs, animated=False).classes('views') as panels:
                    with ui.tab_panel('images'):
                        self.images = Images(self._page, self._set_parameter)
                    with ui.tab_panel('results'), el.box('part results stack'):
                        self._scene = PoseScene()
                        self._results_of = ui.tab_panels(animated=False).classes('views')
                    with ui.tab_panel('runs'):
                        self._runs = Runs(self._page, self._load)
                # Beside the others, or instead of them on a telephone.
                self._parameters_place = el.box('part parameters', 'section')
                with self._parameters_place.props('aria-label=Parameters'):
                    self._parameters_of = ui.tab_panels(animated=False).classes('views')
        self._tabs.set_value(self._page.kept['part'])
        # A button uses the space bar itself; the other keys are the panel's there, too.
        ui.keyboard(self._key, repeating=False, ignore=['input', 'select', 'textarea'])
        ui.skip_link('Skip to the images and results', target=panels)
        ui.skip_link('Skip to the parameters', target=self._parameters_place)
        client.on_connect(self._connected)
        client.on_disconnect(self._disconnected)
        client.on_delete(lambda: services.system.leave(self._node_changed))
        services.sets_changed.subscribe(self._sets_changed)
        self._connected()

    def _show_part(self, event: Any) -> None:
        self._page.kept['part'] = str(event.value)
        el.set_props(self._root, data_part=self._page.kept['part'])
        self._scene.appear(event.value == 'results')
        self._runs.frames.appear(event.value == 'runs')

    async def _key(self, event: Any) -> None:
        key, control = event.key.name, event.modifiers.ctrl or event.modifiers.meta
        if not event.action.keydown or event.modifiers.alt:
            return
        if control and key.lower() in ('z', 'y') and self._parameters:
            await self._parameters.step(back=key.lower() == 'z' and not event.modifiers.shift)
        elif control:
            return
        elif key == '/' and self._parameters:
            self._parameters.find()
        elif key in ('1', '2', '3', '4'):
            self._tabs.set_value(list(_PARTS)[int(key) - 1])
        elif key == ' ':
            self._runs.frames.play() if self._tabs.value == 'runs' else self._head.pause()
        elif key in ('ArrowLeft', 'ArrowRight') and self._tabs.value == 'runs':
            self._runs.frames.step(1 if key == 'ArrowRight' else -1)
        elif key == '?':
            show_keys()

    def _connected(self) -> None:
        self._page.services.system.listen(self._node_changed)
        self._refresh()

    def _disconnected(self) -> None:
        if not self._client.has_socket_connection:
            self._page.services.system.leave(self._node_changed)

    def _node_changed(self, what: str, node: LiveNode) -> None:
        ours = node.name == self._page.selected
        with self._root:
            if what == 'status':
                self._head.refresh()
                if ours and self._parameters:
                    self._parameters.show_status()
                if ours and self._results:
                    self._results.show()
            elif what == 'nodes' or ours:
                self._refresh()
                self._runs.frames.show()
            else:
                self.images.refresh()

    def _refresh(self) -> None:
        # The head first: it selects a node where none is.
        self._head.refresh()
        self.images.refresh()
        el.set_props(self._root, data_node=self._page.selected)
        node = self._page.node
        key = f'{node.name} {PROCESSORS[node.kind].panel.image}' if node else ''
        el.set_props(self._preview, data_key=key)
        self._scene.show(node)
        self._show_parts(node)

    def _show_parts(self, node: LiveNode | None) -> None:
        """Those of other nodes stay, for what is clicked before they are off the screen."""
        name, made_of = (node.name, (node, *node.controls)) if node else ('none', ())
        for gone in self._parts.keys() - {*self._page.services.system.nodes, name}:
            self._drop_parts(gone)
        if name in self._parts and self._parts[name][0] == made_of:
            if parameters := self._parts[name][2]:
                parameters.show()
        else:
            self._drop_parts(name)
            self._parts[name] = made_of, *self._make_parts(name, node)
        _, self._results, self._parameters = self._parts[name]
        for place in (self._results_of, self._parameters_of):
            place.value = name

    def _drop_parts(self, name: str) -> None:
        self._parts.pop(name, None)
        for old in [*self._results_of, *self._parameters_of]:
            if old.props['name'] == name:
                old.delete()

    def _make_parts(
        self, name: str, node: LiveNode | None
    ) -> tuple[Results | None, Parameters | None]:
        with self._results_of, ui.tab_panel(name), el.box('stack'):
            results = Results(self._page, node) if node else None
            if node is None:
                el.empty('No results yet', 'They appear as soon as a node runs.', card=True)
        with self._parameters_of, ui.tab_panel(name):
            parameters = Parameters(self._page, node) if node and node.controls else None
            if parameters is None:
                el.empty('No parameters yet', 'They appear as soon as a node answers.', card=True)
        return results, parameters

    def _selected(self) -> None:
        self._refresh()
        if self._results and self._parameters:
            self._results.show()
            self._parameters.appear()
        self._runs.choose_recording()

    def _sets_changed(self) -> None:
        self._runs.frames.reload_sets()
        if self._parameters:
            self._parameters.show_sets()

    def _set_parameter(self, node: str, name: str, value: Value) -> None:
        self._page.select(node)
        if self._parameters:
            self._parameters.edit(name, value)

    async def _load(self, values: Mapping[str, Value], name: str) -> None:
        if self._parameters:
            await self._parameters.load(values, name)

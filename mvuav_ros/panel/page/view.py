"""The whole page, for one browser tab."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from typing import Any

from nicegui import Client, ui

from mvuav_ros.panel.live_node import LiveNode
from mvuav_ros.panel.page.context import Page, Services
from mvuav_ros.panel.page.elements import box, empty, set_props
from mvuav_ros.panel.page.head import Head
from mvuav_ros.panel.page.images import Images
from mvuav_ros.panel.page.parameters import Parameters
from mvuav_ros.panel.page.results import Results
from mvuav_ros.panel.page.runs import Runs
from mvuav_ros.parameters.declaration import Value

_PARTS = {'images': 'Images', 'results': 'Results', 'runs': 'Runs', 'parameters': 'Parameters'}


class View:
    """Puts the parts together, for a browser tab that is connected, and tells them what changes."""

    def __init__(self, services: Services, client: Client, kept: MutableMapping[str, Any]) -> None:
        self._page, self._client = Page(services, kept, self._selected), client
        self._parameters: Parameters | None = None
        self._results: Results | None = None
        self._built: tuple[object, ...] = ('nothing yet',)
        part = kept.get('part')
        with box('panel') as self._root:
            self._head = Head(self._page)
            with box('body'):
                with ui.tabs(on_change=self._show_part) as tabs:
                    for key, words in _PARTS.items():
                        ui.tab(key, words).classes(f'tab {key}')
                tabs.props('dense no-caps inline-label align=left aria-label="Parts of the panel"')
                with ui.tab_panels(tabs, animated=False).classes('views') as panels:
                    with ui.tab_panel('images'):
                        self.images = Images(self._page, self._set_parameter)
                    with ui.tab_panel('results'):
                        self._results_place = box('part results stack')
                    with ui.tab_panel('runs'):
                        self._runs = Runs(self._page, self._load)
                # Beside the others, or instead of them on a telephone.
                self._parameters_place = box('part parameters', 'section')
                self._parameters_place.props('aria-label=Parameters')
        tabs.set_value(part if part in _PARTS else 'images')
        ui.skip_link('Skip to the images and results', target=panels)
        ui.skip_link('Skip to the parameters', target=self._parameters_place)
        client.on_connect(self._connected)
        client.on_disconnect(self._disconnected)
        client.on_delete(self._closed)
        services.sets_changed.subscribe(self._sets_changed)
        self._connected()

    def _show_part(self, event: Any) -> None:
        self._page.kept['part'] = str(event.value)
        set_props(self._root, data_part=self._page.kept['part'])

    def _connected(self) -> None:
        self._page.services.system.listen(self._heard)
        self._refresh()

    def _disconnected(self) -> None:
        if not self._client.has_socket_connection:
            self._page.services.system.leave(self._heard)

    def _closed(self) -> None:
        self._page.services.system.leave(self._heard)
        self.images.stop_recording()

    def _heard(self, what: str, node: LiveNode) -> None:
        ours = node.name == self._page.selected
        with self._root:
            if what == 'nodes':
                self._refresh()
            elif what == 'values':
                self.images.show_values()
                if ours and self._parameters:
                    self._parameters.show()
            elif what == 'status':
                self._head.refresh()
                self.images.show_recording()
                if ours and self._parameters:
                    self._parameters.show_status()
                if ours and self._results:
                    self._results.show()

    def _refresh(self) -> None:
        # The head first: it selects a node where none is.
        self._head.refresh()
        self.images.refresh()
        set_props(self._root, data_node=self._page.selected)
        node = self._page.node
        built = (node, *node.controls) if node else ()
        if built != self._built:
            self._built = built
            self._build(node)
        elif self._parameters:
            self._parameters.show()

    def _build(self, node: LiveNode | None) -> None:
        """The parts of the selected node anew: it is another one, or has come back."""
        for place in (self._results_place, self._parameters_place):
            place.clear()
        with self._results_place:
            self._results = Results(self._page, node) if node else None
            if node is None:
                empty('No results yet', 'They appear as soon as a node runs.', 'card empty')
        with self._parameters_place:
            self._parameters = Parameters(self._page, node) if node and node.controls else None
            if self._parameters is None:
                empty('No parameters yet', 'They appear as soon as a node answers.', 'card empty')

    def _selected(self) -> None:
        self._refresh()
        self._runs.choose_recording()

    def _sets_changed(self) -> None:
        if self._parameters:
            self._parameters.show_sets()

    def _set_parameter(self, node: str, name: str, value: Value) -> None:
        self._page.select(node)
        if self._parameters:
            self._parameters.edit(name, value)

    async def _load(self, values: Mapping[str, Value], name: str) -> None:
        if self._parameters:
            await self._parameters.load(values, name)

"""The whole page, for one browser tab."""

from __future__ import annotations

from collections.abc import MutableMapping
from contextlib import suppress
from typing import Any

from nicegui import Client, ui

from mvuav_ros.panel.live_system import LiveNode
from mvuav_ros.panel.page.context import Page, Services
from mvuav_ros.panel.page.elements import box, set_prop
from mvuav_ros.panel.page.head import Head
from mvuav_ros.panel.page.images import KEPT_ARRANGEMENT, Images
from mvuav_ros.panel.page.parameters import Parameters
from mvuav_ros.panel.page.results import Results
from mvuav_ros.panel.page.runs import Runs
from mvuav_ros.parameters.declaration import Value

_PARTS = {'images': 'Images', 'results': 'Results', 'runs': 'Runs', 'parameters': 'Parameters'}


class View:
    """Puts the parts together and tells them what has changed."""

    def __init__(self, services: Services, client: Client, kept: MutableMapping[str, Any]) -> None:
        """Make the page of a browser tab that is connected.

        Args:
            services: of the process.
            client: the browser tab.
            kept: what the tab remembers across reloads.
        """
        self._page = Page(services, kept)
        self._client = client
        part = kept.get('part')
        with box('panel') as self._root:
            self._head = Head(self._page)
            with box('body'):
                tabs = self._tabs()
                with ui.tab_panels(tabs, animated=False).classes('views') as panels:
                    with ui.tab_panel('images'):
                        self._images = Images(self._page, self._set_parameter)
                    with ui.tab_panel('results'):
                        self._results = Results(self._page)
                    with ui.tab_panel('runs'):
                        Runs(self._page, lambda *given: self._parameters.load(*given))
                # Beside the others, or instead of them on a telephone.
                self._parameters = Parameters(self._page)
        tabs.set_value(part if part in _PARTS else 'images')
        ui.skip_link('Skip to the images and results', target=panels)
        ui.skip_link('Skip to the parameters', target=self._parameters.element)
        self._page.on_select.append(self._name_node)
        self._name_node()
        client.on_connect(self._connected)
        client.on_disconnect(self._disconnected)
        client.on_delete(self._closed)
        ui.timer(0.0, self._connected, once=True)
        ui.timer(0.0, self._restore, once=True)

    def _tabs(self) -> ui.tabs:
        with ui.tabs(on_change=self._show_part) as tabs:
            tabs.props('dense no-caps inline-label align=left')
            tabs.props['aria-label'] = 'Parts of the panel'
            for key, words in _PARTS.items():
                ui.tab(key, words).classes(f'tab {key}')
        return tabs

    def _show_part(self, event: Any) -> None:
        self._page.kept['part'] = str(event.value)
        set_prop(self._root, 'data-part', self._page.kept['part'])

    async def _restore(self) -> None:
        # On a slow link the usual arrangement will do.
        with suppress(TimeoutError):
            self._images.restore(await ui.run_javascript(KEPT_ARRANGEMENT, timeout=10.0))

    def _connected(self) -> None:
        self._page.services.system.listen(self._heard)
        self._refresh()

    def _disconnected(self) -> None:
        if not self._client.has_socket_connection:
            self._page.services.system.leave(self._heard)

    async def _closed(self) -> None:
        self._page.services.system.leave(self._heard)
        await self._images.stop_recording()

    def _heard(self, what: str, node: LiveNode) -> None:
        ours = node.name == self._page.selected
        with self._root:
            if what == 'nodes':
                self._refresh()
            elif what == 'values':
                self._images.show_values()
                if ours:
                    self._parameters.show_values()
            elif what == 'status':
                self._head.refresh()
                self._images.show_recording()
                if ours:
                    self._parameters.show_status()
                    self._results.show()
            elif what == 'statistics' and ours:
                self._results.show()

    def _refresh(self) -> None:
        self._head.refresh()
        for part in (self._parameters, self._images, self._results):
            part.refresh()

    def _name_node(self) -> None:
        set_prop(self._root, 'data-node', self._page.selected)

    def _set_parameter(self, node: str, name: str, value: Value) -> None:
        if node != self._page.selected:
            self._page.select(node)
        self._parameters.edit(name, value)

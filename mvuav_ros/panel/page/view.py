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
        part = str(kept.get('part', 'images'))
        with box('panel') as self._root:
            self._root.props['data-part'] = part if part in _PARTS else 'images'
            self._head = Head(self._page)
            with box('body'):
                self._tabs(part)
                with box('views') as main:
                    self._images = Images(self._page, self._set_parameter)
                    self._results = Results(self._page)
                    self._parameters = Parameters(self._page)
                    self._runs = Runs(self._page, self._parameters.load)
                # Beside the others, or instead of them on a telephone.
                self._parameters.element.move(self._root.default_slot.children[-1])
        ui.skip_link('Skip to the images and results', target=main)
        ui.skip_link('Skip to the parameters', target=self._parameters.element)
        self._page.on_select.append(self._name_node)
        self._name_node()
        client.on_connect(self._connected)
        client.on_disconnect(self._disconnected)
        client.on_delete(self._closed)
        ui.timer(0.0, self._connected, once=True)
        ui.timer(0.0, self._restore, once=True)

    def _tabs(self, part: str) -> None:
        with ui.tabs(on_change=self._keep_part) as tabs:
            tabs.props('dense no-caps inline-label align=left')
            tabs.props['aria-label'] = 'Parts of the panel'
            for key, words in _PARTS.items():
                ui.tab(key, words).classes(f'tab {key}')
        tabs.set_value(part if part in _PARTS else 'images')
        # At once, before the server has heard of it.
        tabs.on('update:model-value', js_handler='(part) => window.panelPart(part)')

    def _keep_part(self, event: Any) -> None:
        self._page.kept['part'] = str(event.value)

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

"""The whole page, for one browser tab."""

from __future__ import annotations

from nicegui import Client, ui

from mvuav_ros.panel.live_system import LiveNode
from mvuav_ros.panel.page.context import Page, Services
from mvuav_ros.panel.page.elements import box, text
from mvuav_ros.panel.page.head import Head
from mvuav_ros.panel.page.images import KEPT_ARRANGEMENT, Images
from mvuav_ros.panel.page.parameters import Parameters
from mvuav_ros.panel.page.results import Results
from mvuav_ros.panel.page.runs import Runs
from mvuav_ros.parameters.declaration import Value

_PARTS = {
    'parameters': 'Parameters',
    'images': 'Images',
    'results': 'Results',
    'runs': 'Runs',
}


class View:
    """Puts the parts together and tells them what has changed."""

    def __init__(self, services: Services, client: Client) -> None:
        """Make the page; nothing is followed before the browser has connected.

        Args:
            services: of the process.
            client: the browser tab.
        """
        self._page = Page(services)
        self._restored = False
        self._client = client
        with box('panel').props('data-part=parameters') as self._root:
            self._head = Head(self._page)
            with box('body'):
                with box('tabs', 'nav').props('role=tablist aria-label="Parts of the panel"'):
                    for key, words in _PARTS.items():
                        tab = box(f'tab {key}', 'button').props('type=button role=tab')
                        tab.props['aria-selected'] = str(key == 'parameters').lower()
                        tab.on('click', js_handler=f'() => window.panelPart("{key}")')
                        with tab:
                            text(words, tag='span')
                self._parameters = Parameters(self._page)
                self._images = Images(self._page, self._set_parameter)
                self._results = Results(self._page)
                self._runs = Runs(self._page)
        self._page.on_select.append(self._name_node)
        client.on_connect(self._connected)
        client.on_disconnect(self._disconnected)
        client.on_delete(self._closed)

    async def _connected(self) -> None:
        self._page.services.system.listen(self._heard)
        self._refresh()
        if not self._restored:
            self._restored = True
            try:
                with self._root:
                    self._images.restore(await ui.run_javascript(KEPT_ARRANGEMENT))
            except TimeoutError:
                # A slow link; the usual arrangement will do.
                pass

    def _disconnected(self) -> None:
        if not self._client.has_socket_connection:
            self._closed()

    def _closed(self) -> None:
        self._page.services.system.leave(self._heard)

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
                if ours:
                    self._parameters.show_status()
                    self._results.show()
            elif what == 'statistics' and ours:
                self._results.refresh()
                self._results.show()

    def _refresh(self) -> None:
        self._head.refresh()
        for part in (self._parameters, self._images, self._results):
            part.refresh()

    def _name_node(self) -> None:
        self._root.props['data-node'] = self._page.selected
        self._root.update()

    def _set_parameter(self, node: str, name: str, value: Value) -> None:
        if node != self._page.selected:
            self._page.select(node)
        self._parameters.edit(name, value)

"""The whole page, for one browser tab: its head, and the parts below."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from typing import Any

from nicegui import Client, ui

from mvuav_ros.detectors import DETECTORS
from mvuav_ros.panel.image_feed import RESULT_OF_KIND
from mvuav_ros.panel.live_nodes import LiveNode
from mvuav_ros.panel.page import elements as el
from mvuav_ros.panel.page.context import Page, Services
from mvuav_ros.panel.page.parameters import Parameters
from mvuav_ros.panel.page.readout import PoseScene, Results, make_readout
from mvuav_ros.panel.page.recorder import RecordingButton
from mvuav_ros.panel.page.run_list import Runs
from mvuav_ros.panel.page.tiles import Images
from mvuav_ros.parameters.declaration import Value

_PARTS = {
    'images': 'Images',
    'results': 'Results',
    'runs': 'Recordings',
    'parameters': 'Parameters',
}
_KEYS = {
    '/': 'Find a parameter',
    '1 to 4': 'Images, Results, Recordings, Parameters',
    'space': 'Pause images and curves, or play the recording',
    '← →': 'One frame of the recording back or on',
    'Ctrl+Z': 'Undo a change',
    'Ctrl+Shift+Z': 'Redo it',
    '?': 'This list',
}
_FIGURES = {
    'input_rate_hz': ('in', 'Hz'),
    'output_rate_hz': ('out', 'Hz'),
    'latency_p50_ms': ('latency p50', 'ms'),
    'latency_p95_ms': ('p95', 'ms'),
    'frames_rejected': ('rejected', ''),
}


class Head:
    """Node buttons and the chosen node's diagnostics."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._dark = ui.dark_mode(value=None)
        self._buttons: dict[str, ui.button] = {}
        with el.box('head', 'header'):
            el.text('Tuning panel', tag='h1')
            self._nodes = el.box('nodes grow').props('role=group aria-label="Nodes"')
            self._recording = RecordingButton(page)
            self._pause = el.icon_button('pause', 'Pause', self.pause)
            el.icon_button('keyboard', 'Keys', show_keys)
            el.icon_button('contrast', 'Light or dark', self._toggle)
        with el.box('health'):
            self._figures = {}
            for key, (words, unit) in _FIGURES.items():
                with el.box():
                    el.text(words, 'soft small')
                    self._figures[key] = el.text('-', 'number')
                    el.text(unit, 'soft small')
            self._words = el.text('', 'words soft small')

    def pause(self) -> None:
        """Hold what is shown of the node, or go on; ``static/live.js`` follows the attribute."""
        paused = self._pause.props.get('icon') == 'pause'
        self._pause.set_icon('play_arrow' if paused else 'pause')
        el.set_props(self._pause, aria_label='Go on' if paused else 'Pause', data_paused=paused)

    async def _toggle(self) -> None:
        dark = await ui.run_javascript('return document.body.classList.contains("body--dark")')
        self._dark.value = not dark

    def _node_button(self, name: str) -> ui.button:
        made = ui.button(name, icon='circle', color=None)
        return made.props('flat rounded no-caps').on_click(lambda: self._page.select(name))

    def refresh(self) -> None:
        """After nodes came or went, were selected, or said something."""
        nodes = self._page.services.system.nodes
        alive = [name for name, node in nodes.items() if node.alive]
        # What was chosen before a reload may need a moment to be found again.
        if self._page.node is None and nodes and (alive or not self._page.selected):
            self._page.select((alive or list(nodes))[0])
            return
        if list(nodes) != list(self._buttons) or not nodes:
            # Only then: a button that is made anew loses the keyboard's focus.
            self._nodes.clear()
            with self._nodes:
                self._buttons = {name: self._node_button(name) for name in nodes}
                if not nodes:
                    el.text('looking for nodes …', 'soft')
        for name, button in self._buttons.items():
            each = nodes[name]
            state = '' if each.alive else 'gone' if each.controls else 'starting'
            recorded = 'recording' if self._recording.is_under_way(name) else ''
            color = 'bad' if state == 'gone' else 'warn' if state or each.level else 'good'
            button.set_text(' '.join(filter(None, (name, state, recorded))))
            button.classes(replace=f'node {color}')
            el.set_props(button, aria_pressed=str(name == self._page.selected).lower())
        self._recording.show()
        node = self._page.node
        for key, label in self._figures.items():
            value = node.status.get(key, '-') if node is not None and node.alive else '-'
            label.set_text('-' if value == 'nan' else value[:12])
        if node is None:
            words = f'Start {" or ".join(DETECTORS)}; it appears here by itself.'
        elif not node.alive and node.controls:
            words = 'The node is gone. The panel uses it again as soon as it is back.'
        else:
            words = node.message
        self._words.set_text(words)


def show_keys() -> None:
    """The list of keys."""
    with el.dialog('Keys'):
        el.fill(el.sheet('Keys', ('', '')), list(_KEYS.items()))


class PanelView:
    """Puts the parts together, for a browser tab that is connected, and passes on what changes."""

    def __init__(self, services: Services, client: Client, kept: MutableMapping[str, Any]) -> None:
        self._page, self._client = Page(services, kept, self._selected), client
        self._parameters: Parameters | None = None
        self._results: Results | None = None
        self._built: tuple[object, ...] = ('nothing yet',)
        with el.box('panel') as self._root:
            self._head = Head(self._page)
            with el.box('body'):
                self._preview = make_readout()
                with ui.tabs(on_change=self._show_part) as tabs:
                    for key, words in _PARTS.items():
                        ui.tab(key, words).classes(f'tab {key}')
                tabs.props('dense no-caps inline-label align=left aria-label="Parts of the panel"')
                with ui.tab_panels(tabs, animated=False).classes('views') as panels:
                    with ui.tab_panel('images'):
                        self.images = Images(self._page, self._set_parameter)
                    with ui.tab_panel('results'), el.box('part results stack'):
                        self._scene = PoseScene()
                        self._results_place = el.box('stack')
                    with ui.tab_panel('runs'):
                        self._runs = Runs(self._page, self._load)
                # Beside the others, or instead of them on a telephone.
                self._parameters_place = el.box('part parameters', 'section')
                self._parameters_place.props('aria-label=Parameters')
        self._tabs = tabs
        tabs.set_value(self._page.kept['part'])
        # A button uses the space bar itself; the other keys are the panel's there, too.
        ui.keyboard(self._key, repeating=False, ignore=['input', 'select', 'textarea'])
        ui.skip_link('Skip to the images and results', target=panels)
        ui.skip_link('Skip to the parameters', target=self._parameters_place)
        client.on_connect(self._connected)
        client.on_disconnect(self._disconnected)
        client.on_delete(self._closed)
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

    def _closed(self) -> None:
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
        key = f'{node.name} {RESULT_OF_KIND[node.kind]}' if node else ''
        el.set_props(self._preview, data_key=key)
        self._scene.show(node)
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
                el.empty('No results yet', 'They appear as soon as a node runs.', card=True)
        with self._parameters_place:
            self._parameters = Parameters(self._page, node) if node and node.controls else None
            if self._parameters is None:
                el.empty('No parameters yet', 'They appear as soon as a node answers.', card=True)

    def _selected(self) -> None:
        self._refresh()
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

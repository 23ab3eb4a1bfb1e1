"""The head of the page: the nodes, the chosen one's diagnostics, its recording, and pause."""

from __future__ import annotations

import time
from functools import partial

from nicegui import ui

from mvuav_ros.detectors import DETECTORS
from mvuav_ros.panel import sanitized
from mvuav_ros.panel.node_recorder import NodeRecorder
from mvuav_ros.panel.page import elements as el
from mvuav_ros.panel.page.context import Page

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
                self._buttons = {name: ui.button(icon='circle', color=None) for name in nodes}
                for name, button in self._buttons.items():
                    button.props('flat rounded no-caps').on_click(partial(self._page.select, name))
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


class RecordingButton:
    """Starts and ends a recording of the selected node; red meanwhile, with time and size."""

    def __init__(self, page: Page) -> None:
        self._page = page
        with el.box('line record'):
            self._button = el.button('Record', self._toggle, 'fiber_manual_record')
            self._words = el.text('', 'small number').props('role=status')
        ui.timer(1.0, self.show)

    def _toggle(self) -> None:
        node, services = self._page.node, self._page.services
        recorder = services.recorders.get(self._page.selected)
        if recorder and not recorder.over:
            recorder.stop()
            el.notify(f'{recorder.over}: {recorder.path}')
        elif node is None:
            el.notify('There is no node to record.', bad=True)
        else:
            name = f'{node.kind} {time.strftime("%Y-%m-%d %H.%M.%S")}.mcap'
            with el.errors_notified():
                services.recorders[node.name] = NodeRecorder(
                    services.ros, node, services.recordings / name, services.runs_changed.emit
                )
        self.show()

    def is_under_way(self, node: str) -> bool:
        """Whether a node is recorded now."""
        recorder = self._page.services.recorders.get(node)
        return recorder is not None and not recorder.over

    def show(self) -> None:
        """Follow the recording, on whatever page it was begun."""
        recorder = self._page.services.recorders.get(self._page.selected)
        under_way = self.is_under_way(self._page.selected)
        self._button.set_text('Stop' if under_way else 'Record')
        look = 'unelevated color=negative' if under_way else 'outline color=primary'
        self._button.props(look, remove='outline' if under_way else 'unelevated')
        self._words.set_text(sanitized.words(recorder.words) if recorder else '')

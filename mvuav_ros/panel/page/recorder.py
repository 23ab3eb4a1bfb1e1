"""The button that records a node."""

from __future__ import annotations

import time

from nicegui import ui

from mvuav_ros.panel import sanitized
from mvuav_ros.panel.node_recorder import NodeRecorder
from mvuav_ros.panel.page import elements as el
from mvuav_ros.panel.page.context import Page


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

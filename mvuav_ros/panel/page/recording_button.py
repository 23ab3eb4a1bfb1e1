"""The button that records the selected node, and how far that is, on every part of the page."""

from __future__ import annotations

import time

from nicegui import ui

from mvuav_ros.panel import foreign
from mvuav_ros.panel.page import elements as el
from mvuav_ros.panel.page.context import Page
from mvuav_ros.panel.recorder import Recorder
from mvuav_ros.recordings.recording import RecordingError


class RecordingButton:
    """Starts and ends a recording; it is red meanwhile, with time and size."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._recorder: Recorder | None = None
        with el.box('line record'):
            self._button = el.button('Record', self._toggle, 'fiber_manual_record')
            self._words = el.text('', 'small number').props('role=status')
        self._timer = ui.timer(1.0, self._show, active=False)

    def _toggle(self) -> None:
        node, services = self._page.node, self._page.services
        if self._recorder is not None:
            self.stop()
        elif node is None:
            el.tell('There is no node to record.', bad=True)
        else:
            name = f'{node.kind} {time.strftime("%Y-%m-%d %H.%M.%S")}.mcap'
            with el.errors_told():
                self._recorder = Recorder(services.ros, node, services.recordings / name)
            self._show()

    def _show(self) -> None:
        recorder = self._recorder
        self._button.set_text('Stop' if recorder else 'Record')
        look = (
            ('unelevated color=negative', 'outline')
            if recorder
            else ('outline', 'unelevated color')
        )
        self._button.props(look[0], remove=look[1])
        self._timer.active = recorder is not None
        if recorder is None:
            self._words.set_text('')
        elif recorder.error:
            self.stop()
        else:
            minutes, seconds = divmod(int(recorder.seconds), 60)
            self._words.set_text(f'{minutes}:{seconds:02} · {recorder.size / 1e6:.1f} MB')

    def stop(self) -> None:
        """End the recording, also when the page is closed."""
        recorder, self._recorder = self._recorder, None
        if recorder is None:
            return
        try:
            recorder.stop()
            said = f'Recorded {recorder.messages} messages'
        except RecordingError as error:
            said = str(error)
        if not self._words.is_deleted:
            el.tell(f'{said}: {recorder.path} {recorder.error}')
            self._show()
            self._words.set_text(foreign.words(f'{said} {recorder.error}'))
        self._page.services.runs_changed.emit()

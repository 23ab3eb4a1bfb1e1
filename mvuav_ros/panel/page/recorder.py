"""A node's input and results as they come over DDS into a recording, and the button for it."""

from __future__ import annotations

import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ui
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, CompressedImage, Imu
from sensor_msgs.msg import Image as RosImage

from mvuav_ros.messages.sensors import type_name
from mvuav_ros.panel import sanitized
from mvuav_ros.panel.live_nodes import LiveNode
from mvuav_ros.panel.page import elements as el
from mvuav_ros.panel.page.context import Page
from mvuav_ros.panel.ros_thread import RosThread
from mvuav_ros.processing.registry import PROCESSORS
from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.writing import RecordingWriter

LONGEST = 600.0
"""Seconds, after which a recording that was forgotten ends."""


class NodeRecorder:
    """Records one node until it is stopped; its file can be replayed.

    ``messages`` are written so far, of ``size`` bytes; ``error`` says why it ended by itself.
    Making it makes the folder; that and the end raise RecordingError or OSError where the file
    cannot be written.
    """

    def __init__(self, ros: RosThread, node: LiveNode, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path, self.messages, self.size, self.error = path, 0, 0, ''
        self._began = time.monotonic()
        self._writer = RecordingWriter(path, metadata={'recorded': {'node': node.name}})
        self._stopped = False
        self._subscriptions = ExitStack()
        for topic, kind in _topics(node).items():
            image = kind in (RosImage, CompressedImage)
            qos: Any = qos_profile_sensor_data if image else QoSProfile(depth=100)
            keep = partial(self._keep, topic, type_name(kind))
            self._subscriptions.callback(ros.subscribe(kind, topic, keep, qos, raw=True))

    @property
    def seconds(self) -> float:
        """Since it began."""
        return time.monotonic() - self._began

    def stop(self) -> None:
        """End the recording."""
        self._stopped = True
        self._subscriptions.close()
        self._writer.close()

    def _keep(self, topic: str, kind: str, data: bytes) -> None:
        if self.error:
            return
        try:
            self._writer.write(topic, kind, time.time_ns(), data)
            self.messages += 1
            self.size += len(data)
        except RecordingError as error:
            # One message may come after the end.
            self.error = '' if self._stopped else str(error)
        if self.seconds > LONGEST:
            self.error = f'ended after {LONGEST:.0f} s'


def _topics(node: LiveNode) -> dict[str, type]:
    processor = PROCESSORS[node.kind]
    topics = {**processor.topics, **processor.periodic_topics}
    found: dict[str, type] = {f'{node.name}/{topic}': kind for topic, kind in topics.items()}
    if node.image_topic:
        found[node.image_topic] = CompressedImage if node.found.compressed else RosImage
        found[node.camera_info_topic] = CameraInfo
    if node.found.imu_topic:
        found[node.found.imu_topic] = Imu
    return found


class RecordingButton:
    """Starts and ends a recording; it is red meanwhile, with time and size."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._recorder: NodeRecorder | None = None
        with el.box('line record'):
            self._button = el.button('Record', self._toggle, 'fiber_manual_record')
            self._words = el.text('', 'small number').props('role=status')
        self._timer = ui.timer(1.0, self._show, active=False)

    def _toggle(self) -> None:
        node, services = self._page.node, self._page.services
        if self._recorder is not None:
            self.stop()
        elif node is None:
            el.notify('There is no node to record.', bad=True)
        else:
            name = f'{node.kind} {time.strftime("%Y-%m-%d %H.%M.%S")}.mcap'
            with el.errors_notified():
                self._recorder = NodeRecorder(services.ros, node, services.recordings / name)
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
            el.notify(f'{said}: {recorder.path} {recorder.error}')
            self._show()
            self._words.set_text(sanitized.words(f'{said} {recorder.error}'))
        self._page.services.runs_changed.emit()

"""A node's input and results, as they come over DDS, into a recording."""

from __future__ import annotations

import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, CompressedImage
from sensor_msgs.msg import Image as RosImage

from mvuav_ros.messages.sensors import type_name
from mvuav_ros.panel.live_node import LiveNode
from mvuav_ros.panel.ros_thread import RosThread
from mvuav_ros.processing.registry import PROCESSORS
from mvuav_ros.recordings.recording import RecordingError
from mvuav_ros.recordings.writing import RecordingWriter

LONGEST = 600.0
"""Seconds, after which a recording that was forgotten ends."""


class Recorder:
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
        base = node.image_topic.removesuffix('/compressed').rpartition('/')[0]
        found[f'{base}/camera_info'] = CameraInfo
    return found

"""A node's input and results as they come over DDS into a recording."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, CompressedImage, Imu
from sensor_msgs.msg import Image as RosImage

from mvuav_ros.messages import detections, poses
from mvuav_ros.messages.sensors import type_name
from mvuav_ros.panel.live_nodes import LiveNode
from mvuav_ros.panel.ros_thread import OtherTypeError, RosThread
from mvuav_ros.processing.registry import PROCESSORS
from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.writing import RecordingWriter

LONGEST = 600.0
"""Seconds, after which a recording that was forgotten ends."""
_DEPTH = 100
"""Messages of a topic that wait while the process is busy."""


class NodeRecorder:
    """Records one node until it is stopped, whatever pages look on; its file can be replayed.

    ``messages`` are written so far; ``over`` says how it ended. Making it makes
    the folder; it raises RecordingError or OSError where the file cannot be written, or a topic not
    be subscribed. ``on_end`` is called in the loop, in which it is made.
    """

    def __init__(
        self, ros: RosThread, node: LiveNode, path: Path, on_end: Callable[[], object]
    ) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path, self.messages, self.over = path, 0, ''
        self._ros, self._on_end = ros, on_end
        self._began = time.monotonic()
        self._writer = RecordingWriter(path, metadata={'recorded': {'node': node.name}})
        self._subscriptions = ExitStack()
        forgotten = asyncio.get_running_loop().call_later(
            LONGEST, self.stop, f'ended after {LONGEST:.0f} s'
        )
        self._subscriptions.callback(forgotten.cancel)
        try:
            self._subscribe(node)
        except OtherTypeError as error:
            self._subscriptions.close()
            self._writer.close()
            path.unlink()
            raise RecordingError(str(error)) from error

    @property
    def words(self) -> str:
        """How far it is, or how it ended."""
        minutes, seconds = divmod(int(time.monotonic() - self._began), 60)
        return self.over or f'{minutes}:{seconds:02} · {self._writer.size / 1e6:.1f} MB'

    def _subscribe(self, node: LiveNode) -> None:
        for topic, kind in _topics(node).items():
            # What the node hears may be published at best effort; a busy panel takes it later.
            is_input = kind in (RosImage, CompressedImage, CameraInfo, Imu)
            policy = ReliabilityPolicy.BEST_EFFORT if is_input else ReliabilityPolicy.RELIABLE
            # Transforms that hold for the whole flight may have been published long before.
            is_latched = topic == poses.TF_STATIC_TOPIC
            kept = DurabilityPolicy.TRANSIENT_LOCAL if is_latched else DurabilityPolicy.VOLATILE
            qos = QoSProfile(depth=_DEPTH, reliability=policy, durability=kept)
            keep = partial(self._keep, topic, type_name(kind))
            self._subscriptions.callback(self._ros.subscribe(kind, topic, keep, qos, raw=True))

    def stop(self, reason: str = '') -> None:
        """End the recording."""
        if self.over:
            return
        self._subscriptions.close()
        self.over = f'Recorded {self.messages} messages {reason}'.rstrip()
        try:
            self._writer.close()
        except RecordingError as error:
            self.over = str(error)
        self._on_end()

    def _keep(self, topic: str, kind: str, data: bytes) -> None:
        # One message may come after the end.
        if self.over:
            return
        try:
            self._writer.write(topic, kind, time.time_ns(), data)
            self.messages += 1
        except RecordingError as error:
            self._ros.call_in_loop(self.stop, str(error))


def _topics(node: LiveNode) -> dict[str, type]:
    processor = PROCESSORS[node.kind]
    topics = {**processor.topics, **processor.periodic_topics}
    found: dict[str, type] = {f'{node.name}/{topic}': kind for topic, kind in topics.items()}
    # Those of the markers are named after the rig.
    kinds = {type_name(kind): kind for kind in (*topics.values(), *detections.TYPES.values())}
    found |= {topic: kinds[kind] for topic, kind in node.found.results if kind in kinds}
    if node.image_topic:
        found[node.image_topic] = CompressedImage if node.found.compressed else RosImage
        found[node.camera_info_topic] = CameraInfo
    if node.found.imu_topic:
        found[node.found.imu_topic] = Imu
    if poses.TF_TYPE is not None:
        found[poses.TF_STATIC_TOPIC] = poses.TF_TYPE
    return found

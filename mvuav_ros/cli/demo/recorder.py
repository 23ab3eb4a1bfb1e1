"""A node that records topics and keeps the newest message of each for the live table."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Image

from mvuav_ros.messages.sensors import type_name
from mvuav_ros.recordings.writing import RecordingWriter

RATE_WINDOW = 2.0
EVERYTHING = QoSProfile(history=HistoryPolicy.KEEP_ALL, depth=1)


class Recorder(Node):
    """Writes every message as it came over DDS.

    Keeps the ``newest`` of each topic but images', their ``counts``, and ``latency_ms``: the median
    of each processing node, from ``/diagnostics``.
    """

    def __init__(self, topics: dict[str, type], writer: RecordingWriter, context: Any) -> None:
        super().__init__('demo_recorder', context=context)
        self.newest: dict[str, Any] = {}
        self.counts = dict.fromkeys(topics, 0)
        self.latency_ms: dict[str, str] = {}
        self.changed_at = time.monotonic()
        self._arrivals: dict[str, deque[float]] = {topic: deque() for topic in topics}
        self._writer = writer
        for topic, kind in topics.items():
            self.create_subscription(kind, topic, self._keeper(topic, kind), EVERYTHING, raw=True)
        self.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)

    def hears(self, topics: Iterable[str]) -> bool:
        """Whether each of the topics has a publisher."""
        return all(self.count_publishers(topic) > 0 for topic in topics)

    def rate(self, topic: str) -> float:
        """Messages per second in the moments before the newest one."""
        arrivals = self._arrivals[topic]
        while arrivals and arrivals[0] < arrivals[-1] - RATE_WINDOW:
            arrivals.popleft()
        return len(arrivals) / RATE_WINDOW

    def _keeper(self, topic: str, kind: type) -> Any:
        name = type_name(kind)

        def keep(data: bytes) -> None:
            self._writer.write(topic, name, time.time_ns(), data)
            self.counts[topic] += 1
            self.changed_at = time.monotonic()
            self._arrivals[topic].append(self.changed_at)
            if kind is not Image:
                self.newest[topic] = deserialize_message(data, kind)

        return keep

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            latency = values.get('latency_p50_ms', 'nan')
            # After the flight there is none any more.
            if latency != 'nan':
                self.latency_ms[status.name] = latency

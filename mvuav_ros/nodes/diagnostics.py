"""Statuses on ``/diagnostics``: how they are sent, and what ``video_source`` says in its own."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from mvuav_ros.nodes.frame_statistics import WINDOW
from mvuav_ros.vision.image import Image


def every_second(node: Node, action: Callable[[], None]) -> None:
    """Wall time even under use_sim_time: diagnostics must speak when the simulation stands."""
    node.create_timer(1.0, action, clock=Clock(clock_type=ClockType.STEADY_TIME))


def publish_status(node: Node, report: Callable[[], DiagnosticStatus]) -> None:
    """Have a node say once a second how it is."""
    publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)

    def publish() -> None:
        message = DiagnosticArray(status=[report()])
        message.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(message)

    every_second(node, publish)


def status(level: bytes, name: str, message: str, values: Mapping[str, str]) -> DiagnosticStatus:
    """A status with its key-values."""
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticStatus(level=level, name=name, message=message, values=pairs)


class SourceStatus:
    """Rate, state and the last trouble of a source.

    Attributes:
        state: ``waiting`` for subscribers, ``playing``, ``ended`` or ``retrying``; the lifecycle
            state while the node is not active.
        source: what it is, for people.
    """

    def __init__(self, source: str) -> None:
        self.state = 'unconfigured'
        self.source = source
        self._count = self._troubles = 0
        self._times: deque[float] = deque()
        self._last_trouble, self._last_trouble_at = '', -WINDOW
        self._format = ''

    def published(self, image: Image) -> None:
        """Count a frame."""
        self._count += 1
        self._times.append(time.monotonic())
        self._format = f'{image.width}x{image.height} {image.encoding}'

    def trouble(self, words: str) -> None:
        """Keep what went wrong."""
        self._troubles += 1
        self._last_trouble, self._last_trouble_at = words, time.monotonic()

    def report(self, name: str, paused: bool, subscribers: int) -> DiagnosticStatus:
        """The node's diagnostic status."""
        now = time.monotonic()
        while self._times and self._times[0] < now - WINDOW:
            self._times.popleft()
        state = 'paused' if paused else self.state
        level, message = DiagnosticStatus.OK, state
        if self.state == 'retrying':
            level, message = DiagnosticStatus.ERROR, self._last_trouble
        elif now - self._last_trouble_at < WINDOW:
            level, message = DiagnosticStatus.WARN, self._last_trouble
        values = {
            'state': state,
            'source': self.source,
            'rate_hz': f'{len(self._times) / WINDOW:.1f}',
            'frames_published': str(self._count),
            'image': self._format,
            'subscribers': str(subscribers),
            'troubles': str(self._troubles),
            'last_trouble': self._last_trouble,
        }
        return status(level, name, message, values)

"""CameraInfo and Imu, live: images wait a moment for those that belong to them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Imu

from mvuav_ros.nodes.received_image import ReceivedImage
from mvuav_ros.nodes.subscriptions import subscribe
from mvuav_ros.recordings.serialization.messages import decode_imu, stamp_ns_of
from mvuav_ros.recordings.sources.pairing import AttitudePairing, StampPairing

LONGEST_HOLD = 0.1
"""Seconds that an image waits for its CameraInfo or attitude, where somebody publishes one."""


class Companion:
    """A topic that images may wait for; used in the images' thread alone."""

    def __init__(
        self, node: Node, kind: type[CameraInfo | Imu], topic: str, is_awaited: Callable[[], bool]
    ) -> None:
        """Subscribe; ``is_awaited`` says whether images are to wait, now."""
        self.subscription = subscribe(node, kind, topic)
        self._kind, self._is_awaited = kind, is_awaited
        self._pairing: StampPairing[Any, ReceivedImage] | AttitudePairing[ReceivedImage]
        if kind is CameraInfo:
            self._pairing, self._field = StampPairing(), 'info'
        else:
            self._pairing, self._field = AttitudePairing(), 'attitude'

    @property
    def holds(self) -> bool:
        """Whether an image waits."""
        return self._pairing.held is not None

    def take(self, ready: Sequence[int]) -> None:
        """Take in what has come, where this is one of the pointers of what is ready."""
        if self.subscription.handle.pointer not in ready:
            return
        while (taken := self.subscription.handle.take_message(self._kind, False)) is not None:
            message: Any = taken[0]
            info = decode_imu(message) if self._kind is Imu else message
            self._pairing.add_info(stamp_ns_of(message.header), info)

    def completed(self, images: Iterable[ReceivedImage]) -> Iterator[ReceivedImage]:
        """The images, in their order, that need not wait any more, with what belongs to them."""
        if self._pairing.is_idle:
            yield from images
            return
        for image in images:
            self._pairing.add_image(image.stamp_ns, image)
        while (found := self._pairing.take(wait=self._may_come())) is not None:
            given: dict[str, Any] = {self._field: found[0]}
            yield found[1]._replace(**given)

    def _may_come(self) -> bool:
        """Whether what the longest-held image waits for may yet come."""
        held = self._pairing.held
        if held is None or not self._is_awaited():
            return False
        is_published = self.subscription.get_publisher_count() > 0
        return is_published and time.perf_counter() < held.taken + LONGEST_HOLD

"""CameraInfo and Imu, live: images wait a moment for those that belong to them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Imu

from mvuav_ros.nodes.received_image import ReceivedImage
from mvuav_ros.nodes.subscriptions import subscribe
from mvuav_ros.recordings.serialization.messages import decode_imu, stamp_ns_of
from mvuav_ros.recordings.sources.pairing import AttitudePairing, StampPairing

LONGEST_HOLD = 0.1
"""Seconds that an image waits for its CameraInfo or attitude, where somebody publishes one."""


@dataclass(frozen=True)
class Companion:
    """A topic that images may wait for, and whether they are to, now."""

    topic: str
    is_awaited: Callable[[], bool]


class CompanionInput:
    """Subscribes to what belongs to images; used in the images' thread alone, but for `close`."""

    def __init__(self, node: Node, info: Companion | None, imu: Companion | None) -> None:
        """Subscribe.

        Args:
            node: whose subscriptions they are.
            info: the CameraInfo, where that may be wanted.
            imu: the body's attitude, where that may be wanted.
        """
        self._node = node
        self._info, self._imu = info, imu
        self._infos = None if info is None else subscribe(node, CameraInfo, info.topic)
        self._imus = None if imu is None else subscribe(node, Imu, imu.topic)
        self._by_info = StampPairing[CameraInfo, ReceivedImage]()
        self._by_attitude = AttitudePairing[ReceivedImage]()

    @property
    def subscriptions(self) -> list[Any]:
        """Those that there are."""
        return [entity for entity in (self._infos, self._imus) if entity is not None]

    @property
    def holds(self) -> bool:
        """Whether an image waits."""
        return self._by_info.held is not None or self._by_attitude.held is not None

    def take(self, ready: Sequence[int]) -> None:
        """Take in what has come.

        Args:
            ready: the pointers of those subscriptions that have something.
        """
        if self._infos is not None and self._infos.handle.pointer in ready:
            while (taken := self._infos.handle.take_message(CameraInfo, False)) is not None:
                self._by_info.add_info(stamp_ns_of(taken[0].header), taken[0])
        if self._imus is not None and self._imus.handle.pointer in ready:
            while (taken := self._imus.handle.take_message(Imu, False)) is not None:
                stamp_ns = stamp_ns_of(taken[0].header)
                self._by_attitude.add_info(stamp_ns, decode_imu(taken[0]))

    def completed(self, images: list[ReceivedImage]) -> Iterator[ReceivedImage]:
        """The images, in their order, that need not wait any more, with what belongs to them."""
        return self._with_attitude(self._with_info(images))

    def _with_info(self, images: Iterable[ReceivedImage]) -> Iterator[ReceivedImage]:
        if self._by_info.is_idle:
            yield from images
            return
        for image in images:
            self._by_info.add_image(image.stamp_ns, image)
        while (pair := self._by_info.take(wait=self._info_may_come())) is not None:
            yield pair[1]._replace(info=pair[0])

    def _with_attitude(self, images: Iterable[ReceivedImage]) -> Iterator[ReceivedImage]:
        if self._by_attitude.is_idle:
            yield from images
            return
        for image in images:
            self._by_attitude.add_image(image.stamp_ns, image)
        while (found := self._by_attitude.take(wait=self._attitude_may_come())) is not None:
            yield found[1]._replace(attitude=found[0])

    def close(self) -> None:
        """Unsubscribe."""
        for subscription in self.subscriptions:
            self._node.destroy_subscription(subscription)

    def _info_may_come(self) -> bool:
        return _may_come(self._info, self._infos, self._by_info.held)

    def _attitude_may_come(self) -> bool:
        return _may_come(self._imu, self._imus, self._by_attitude.held)


def _may_come(wanted: Companion | None, subscription: Any, held: ReceivedImage | None) -> bool:
    """Whether what the longest-held image waits for may yet come."""
    if wanted is None or held is None or not wanted.is_awaited():
        return False
    if subscription.get_publisher_count() == 0:
        return False
    return time.perf_counter() < held.taken + LONGEST_HOLD

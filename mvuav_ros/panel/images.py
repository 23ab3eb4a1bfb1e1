"""Image topics as small JPEG images, subscribed only while somebody looks."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CompressedImage
from sensor_msgs.msg import Image as RosImage

from mvuav_ros.panel.live_system import LiveNode
from mvuav_ros.panel.ros_thread import RosThread, Subscriptions
from mvuav_ros.recordings.serialization.image_decoding import decode_compressed_image, decode_image
from mvuav_ros.recordings.serialization.serialized_image import (
    stamp_ns_in,
    view_compressed_image,
    view_image,
)
from mvuav_ros.vision.image import Image, ImageError

HIGHEST_RATE = 10.0
"""Images per second, Hz."""
LARGEST_SIDE = 640
"""Of what is sent, px."""
_QUALITY = 80
_RATE_WINDOW = 2.0
_OLDEST_LIVE = 10.0
"""Seconds; a stamp from longer ago is a recording's."""

INPUT = 'input'
TITLES = {
    INPUT: 'Input',
    'debug/confined': 'Confined',
    'debug/edges': 'Edges',
    'debug/hough': 'Hough',
    'debug/overlay': 'Overlay',
    'debug_image': 'Markers',
}
RESULT_OF_KIND = {'marker_tracker': 'debug_image', 'runway_detector': 'debug/overlay'}
"""The image with the results drawn in."""
_DRAWN = {
    'marker_tracker': ('debug_image',),
    'runway_detector': ('debug/confined', 'debug/edges', 'debug/overlay', 'debug/hough'),
}


@dataclass(frozen=True)
class Stream:
    """An image that can be shown: a node's input or one of its debug images.

    Attributes:
        node: its name.
        name: of the image.
        topic: empty while it has none.
        compressed: whether that has compressed images.
    """

    node: str
    name: str
    topic: str
    compressed: bool = False

    @property
    def key(self) -> str:
        """As the page names it."""
        return f'{self.node} {self.name}'

    @property
    def title(self) -> str:
        """For people."""
        return TITLES.get(self.name, self.name)


@dataclass(frozen=True)
class Shot:
    """An image ready to be sent.

    Attributes:
        width: of the original, px.
        height: of the original, px.
        jpeg: what is sent.
        rate: of the topic, Hz.
        age_ms: from the stamp until we had it; NaN where the stamp is not of now.
    """

    width: int
    height: int
    jpeg: bytes
    rate: float
    age_ms: float


def streams_of(node: LiveNode) -> list[Stream]:
    """The images of a node."""
    given = Stream(node.name, INPUT, node.image_topic, node.found.compressed)
    drawn = _DRAWN[node.kind]
    return [given, *(Stream(node.name, name, f'{node.name}/{name}') for name in drawn)]


def decode(data: bytes, compressed: bool) -> Image:
    """A serialized message's image.

    Raises:
        ImageError: it cannot be used.
    """
    if compressed:
        return decode_compressed_image(view_compressed_image(data))
    return decode_image(view_image(data))


def encode_jpeg(image: Image, largest: int = LARGEST_SIDE) -> bytes:
    """An image as JPEG with sides of at most ``largest`` px."""
    pixels = _eight_bit(image)
    factor = largest / max(pixels.shape[:2])
    if factor < 1.0:
        size = (max(round(pixels.shape[1] * factor), 1), max(round(pixels.shape[0] * factor), 1))
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    return _encoded('.jpg', pixels, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])


def encode_png(image: Image) -> bytes:
    """An image as PNG at its full size."""
    return _encoded('.png', _eight_bit(image), [])


def _eight_bit(image: Image) -> Any:
    pixels = image.pixels if image.is_gray else image.bgr()
    if pixels.dtype == np.uint8:
        return pixels
    return cv2.convertScaleAbs(pixels, alpha=255.0 / np.iinfo(pixels.dtype).max)


def _encoded(suffix: str, pixels: Any, options: list[int]) -> bytes:
    done, data = cv2.imencode(suffix, pixels, options)
    if not done:
        raise ImageError('the image cannot be encoded')
    return data.tobytes()


Look = Callable[[str, Shot], None]
"""Called in the loop with a stream's key and its newest image."""


class ImageFeed:
    """Subscribes to a topic while at least one viewer looks at it; called from the loop."""

    def __init__(self, ros: RosThread) -> None:
        self._ros = ros
        self._taps: dict[str, _Tap] = {}

    def look(self, stream: Stream, viewer: Look) -> None:
        """Begin to look; a stream whose topic has changed is subscribed anew."""
        tap = self._taps.get(stream.key)
        if tap is None or tap.stream != stream:
            viewers = tap.viewers if tap is not None else set()
            if tap is not None:
                tap.close()
            tap = self._taps[stream.key] = _Tap(self._ros, stream, viewers)
        tap.viewers.add(viewer)

    def look_away(self, key: str, viewer: Look) -> None:
        """End `look`; the last viewer ends the subscription."""
        tap = self._taps.get(key)
        if tap is not None:
            tap.viewers.discard(viewer)
            if not tap.viewers:
                self._taps.pop(key).close()

    def newest(self, key: str) -> Image | None:
        """The image that was shown last, at its full size."""
        tap = self._taps.get(key)
        return tap.newest() if tap is not None else None


class _Tap:
    """One subscription, with the rate capped before anything is decoded."""

    def __init__(self, ros: RosThread, stream: Stream, viewers: set[Look]) -> None:
        self.stream, self.viewers, self._ros = stream, viewers, ros
        self._due = 0.0
        self._arrivals: deque[float] = deque(maxlen=200)
        self._data: bytes | None = None
        self._closed = False
        self._subscription = Subscriptions(ros.node)
        kind = CompressedImage if stream.compressed else RosImage
        qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        ros.do(partial(self._subscription.add, kind, stream.topic, self._on_image, qos, raw=True))

    def newest(self) -> Image | None:
        data = self._data
        return decode(data, self.stream.compressed) if data is not None else None

    def close(self) -> None:
        self._closed = True
        self._ros.do(self._subscription.close)

    def _on_image(self, data: bytes) -> None:
        now = time.monotonic()
        self._arrivals.append(now)
        if self._closed or now < self._due:
            return
        # The mean is capped, not each interval: of 15 Hz two thirds are taken, not half.
        self._due = max(self._due + 1.0 / HIGHEST_RATE, now)
        try:
            image = decode(data, self.stream.compressed)
            jpeg = encode_jpeg(image)
        except ImageError:
            # The node itself says so in its diagnostics.
            return
        self._data = data
        shot = Shot(image.width, image.height, jpeg, self._rate(now), _age_ms(data))
        self._ros.tell(self._show, shot)

    def _show(self, shot: Shot) -> None:
        for viewer in list(self.viewers):
            viewer(self.stream.key, shot)

    def _rate(self, now: float) -> float:
        while self._arrivals[0] < now - _RATE_WINDOW:
            self._arrivals.popleft()
        span = now - self._arrivals[0]
        return (len(self._arrivals) - 1) / span if span > 0 else math.nan


def _age_ms(data: bytes) -> float:
    """From a message's stamp until now."""
    age = time.time() - 1e-9 * stamp_ns_in(data)
    return 1e3 * age if 0.0 <= age < _OLDEST_LIVE else math.nan

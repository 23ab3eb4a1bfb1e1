"""Image topics as small JPEG images, subscribed only while somebody looks."""

from __future__ import annotations

import json
import struct
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

import cv2
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CompressedImage
from sensor_msgs.msg import Image as RosImage

from mvuav_ros.messages.cdr import stamp_ns_in
from mvuav_ros.messages.images import COMPRESSED_IMAGE, IMAGE, ImageDecoder
from mvuav_ros.panel.live_nodes import LiveNode
from mvuav_ros.panel.ros_thread import OtherTypeError, RosThread
from mvuav_ros.processing.registry import PROCESSORS
from mvuav_ros.vision.image import Image, ImageError
from mvuav_ros.vision.runway.debug_images import eight_bits

MAX_RATE = 10.0
"""Images per second, Hz."""
MAX_SIDE = 640
"""Of what is sent, px."""
_QUALITY = 80
_KEPT = 4
"""Images of a stream; one that is held on a page is not the newest any more when that is known."""
_RATE_WINDOW = 2.0
_MAX_LIVE_AGE = 10.0
"""Seconds; a stamp from longer ago is a recording's."""

MAX_STREAMS = 16
"""Shown on one page."""
INPUT = 'input'
_TITLES = {'debug_image': 'Markers'}


class ImageStream(NamedTuple):
    """An image that can be shown: a node's input or one of its debug images.

    ``topic`` is empty while it has none; ``compressed`` says whether that has compressed images.
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
        return _TITLES.get(self.name) or self.name.rpartition('/')[2].replace('_', ' ').capitalize()


def streams_of(node: LiveNode) -> list[ImageStream]:
    """The images of a node."""
    given = ImageStream(node.name, INPUT, node.image_topic, node.found.compressed)
    drawn = PROCESSORS[node.kind].panel.images
    return [given, *(ImageStream(node.name, name, f'{node.name}/{name}') for name in drawn)]


def decode(stream: ImageStream, data: bytes) -> Image:
    """A serialized message's image; ImageError where it cannot be used."""
    return ImageDecoder().decode(COMPRESSED_IMAGE if stream.compressed else IMAGE, data)[1]


def encode_jpeg(image: Image) -> bytes:
    """An image as JPEG with sides of at most `MAX_SIDE`."""
    pixels = _eight_bits(image)
    height, width = pixels.shape[:2]
    factor = MAX_SIDE / max(height, width)
    if factor < 1.0:
        size = (max(round(width * factor), 1), max(round(height * factor), 1))
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    return cv2.imencode('.jpg', pixels, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()


def encode_png(image: Image) -> bytes:
    """An image as PNG at its full size."""
    return cv2.imencode('.png', _eight_bits(image))[1].tobytes()


def _eight_bits(image: Image) -> Any:
    return eight_bits(image.pixels) if image.is_gray else image.bgr()


Look = Callable[[str, bytes], None]
"""Called in the loop with a stream's key and its newest image, as it is sent to pages."""


class ImageFeed:
    """Subscribes to a topic while at least one viewer looks at it; called from the loop."""

    def __init__(self, ros: RosThread) -> None:
        self._ros = ros
        self._taps: dict[ImageStream, _Tap] = {}

    def look(self, viewer: Look, streams: set[ImageStream]) -> None:
        """Have a viewer see these streams and no others."""
        for stream in self._taps.keys() - streams:
            self._taps[stream].viewers.discard(viewer)
            if not self._taps[stream].viewers:
                self._taps.pop(stream).close()
        for stream in streams:
            # A node that is set up wrongly asks for another type, and gets no image either.
            with suppress(OtherTypeError):
                if stream not in self._taps:
                    self._taps[stream] = _Tap(self._ros, stream)
                self._taps[stream].viewers.add(viewer)

    def image(self, key: str, number: int = 0) -> Image | None:
        """The image of this number, or the newest, at its full size; None where there is none."""
        for stream, tap in self._taps.items():
            for kept, data in reversed(tap.kept if stream.key == key else ()):
                if number in (0, kept):
                    return decode(stream, data)
        return None


class _Tap:
    """One subscription, with the rate capped before anything is decoded."""

    def __init__(self, ros: RosThread, stream: ImageStream) -> None:
        self.viewers: set[Look] = set()
        self.kept: tuple[tuple[int, bytes], ...] = ()
        self._ros, self._stream = ros, stream
        self._due, self._number = 0.0, 0
        self._arrivals: deque[float] = deque(maxlen=200)
        kind = CompressedImage if stream.compressed else RosImage
        qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.close = ros.subscribe(kind, stream.topic, self._on_image, qos, raw=True)

    def _on_image(self, data: bytes) -> None:
        now = time.monotonic()
        self._arrivals.append(now)
        if now < self._due:
            return
        # The mean is capped, not each interval: of 15 Hz two thirds are taken, not half.
        self._due = max(self._due + 1.0 / MAX_RATE, now)
        try:
            image = decode(self._stream, data)
            jpeg = encode_jpeg(image)
        except ImageError:
            # The node itself says so in its diagnostics.
            return
        self._number += 1
        self.kept = (*self.kept, (self._number, data))[-_KEPT:]
        header = {'key': self._stream.key, 'width': image.width, 'height': image.height}
        words = {'words': self._rate(now) + _age(data), 'number': self._number}
        text = json.dumps({**header, **words}).encode()
        self._ros.call_in_loop(self._show, struct.pack('<I', len(text)) + text + jpeg)

    def _show(self, message: bytes) -> None:
        for viewer in list(self.viewers):
            viewer(self._stream.key, message)

    def _rate(self, now: float) -> str:
        """Of the topic, Hz."""
        while self._arrivals[0] < now - _RATE_WINDOW:
            self._arrivals.popleft()
        span = now - self._arrivals[0]
        return f'{(len(self._arrivals) - 1) / span:.1f} Hz' if span > 0 else ''


def _age(data: bytes) -> str:
    """From a message's stamp until now, ms, where the stamp is of now."""
    age = time.time() - 1e-9 * stamp_ns_in(data)
    return f' · {1e3 * age:.0f} ms' if 0.0 <= age < _MAX_LIVE_AGE else ''

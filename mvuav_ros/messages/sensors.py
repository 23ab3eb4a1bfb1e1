"""What belongs to images: calibration and attitude, as messages, and the images they belong to."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from dataclasses import replace
from functools import cache
from operator import itemgetter
from typing import Any, Generic, TypeVar

from mvuav_ros.messages.cdr import STAMP_END, STAMP_START, CdrReader, CdrWriter, stamped_doubles
from mvuav_ros.parameters.common_parameters import TRANSPORTS
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import Attitude


@cache
def type_name(kind: type) -> str:
    """A message class as ``pkg/msg/Type``."""
    return f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'


def normalised_type(name: str) -> str:
    """'pkg/Type' as 'pkg/msg/Type'; other names unchanged."""
    parts = name.split('/')
    return f'{parts[0]}/msg/{parts[1]}' if len(parts) == 2 else name


def stamp_ns_of(header: Any) -> int:
    """The stamp of a std_msgs/Header, ns."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def topic_beside(image_topic: str, name: str) -> str:
    """Where camera drivers have what belongs to images: beside the topic of the raw ones.

    >>> topic_beside('/nose/image_raw/ffmpeg', 'camera_info')
    '/nose/camera_info'
    """
    raw, _, transport = image_topic.rpartition('/')
    base = raw if transport in TRANSPORTS else image_topic
    return f'{base.rpartition("/")[0]}/{name}'


def is_rectified_topic(topic: str) -> bool:
    """Whether a topic's name says that its images are rectified, as image_proc's does."""
    return any(word.startswith('image_rect') for word in topic.split('/')[-2:])


class CameraInfoDecoder:
    """Decodes CameraInfo messages in CDR; the same for live nodes and recordings.

    A camera sends its calibration with each image: it is read where the last message had another.
    """

    def __init__(self, image_topic: str = '') -> None:
        """Of a camera whose images have this topic."""
        self._is_rectified = is_rectified_topic(image_topic)
        self._known: tuple[bytes, CameraModel] | None = None

    def decode(self, message: bytes | memoryview) -> tuple[int, CameraModel]:
        """The stamp (ns) and the calibration, usable or not (see `CameraModel.check`).

        It is that of the images as they are: cut to the region of interest, binned, and rectified
        if the name of their topic says so.

        Raises:
            ImageError: the message is damaged.
        """
        reader = CdrReader(message)
        stamp_ns = _stamp_ns(reader)
        others = bytes(message[:STAMP_START]) + bytes(message[STAMP_END:])
        if self._known is None or self._known[0] != others:
            self._known = others, self._read(reader)
        return stamp_ns, self._known[1]

    def _read(self, reader: CdrReader) -> CameraModel:
        reader.text('frame_id')
        height, width = reader.numbers('II')
        model = reader.text('distortion_model')
        counts = (*reader.numbers('I'), 9, 9, 12)
        d, k, r, p = (reader.numbers(f'{count}d') for count in counts)
        camera = CameraModel(width, height, k, d, model, r, p, is_rectified=self._is_rectified)
        across, down, x, y, rows, columns = reader.numbers('6I')
        if columns and rows and (x, y, columns, rows) != (0, 0, width, height):
            camera = camera.cropped(x, y, columns, rows)
        binning = max(across, 1), max(down, 1)
        return camera if binning == (1, 1) else camera.binned(*binning)


def _stamp_ns(reader: CdrReader) -> int:
    """A header's, also one that is no time: calibrations and attitudes are only paired by it."""
    seconds, nanoseconds = reader.numbers('iI')
    return int(seconds * 1_000_000_000 + nanoseconds)


UNKNOWN_ATTITUDE = Attitude(*[math.nan] * 4)
"""Where a sensor sends something, and what it sends says nothing of an image."""


def decode_imu(message: bytes | memoryview) -> tuple[int, Attitude]:
    """The stamp (ns) and orientation of an Imu in CDR; unknown where it has none (REP 145).

    The orientation may be `valid` or not.

    Raises:
        ImageError: the message is damaged.
    """
    reader = CdrReader(message)
    stamp_ns = _stamp_ns(reader)
    sensor = reader.text('frame_id').lstrip('/')
    x, y, z, w, *covariance = reader.numbers('37d')[:13]
    if covariance[0] == -1.0:
        return stamp_ns, UNKNOWN_ATTITUDE
    sigma = math.sqrt(max(0.0, covariance[0], covariance[4]))
    return stamp_ns, Attitude(x, y, z, w, sigma, sensor=sensor)


_NO_BINNING_OR_REGION = bytes(6 * 4 + 1)
CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
IMU = 'sensor_msgs/msg/Imu'

_UNKNOWN = (-1.0, *[0.0] * 8)
"""REP 145."""


def encode_camera_info(camera: CameraModel, header: bytes) -> bytes:
    """A CameraInfo in CDR; without a rectification it is that of an undistorted image.

    Of rectified images, K is what holds for them, so that it does under any topic.
    """
    if camera.is_rectified:
        k = tuple(camera.matrix.ravel().tolist())
        camera = replace(camera, k=k, d=(), r=(), distortion_model='plumb_bob')
    fx, _, cx, _, fy, cy, *_ = camera.k
    r = camera.r or (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    p = camera.p or (fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0)
    writer = CdrWriter(header)
    writer.numbers('II', camera.height, camera.width)
    writer.text(camera.distortion_model)
    writer.numbers('I', len(camera.d))
    writer.numbers(f'{len(camera.d) + 30}d', *camera.d, *camera.k, *r, *p)
    writer.written(_NO_BINNING_OR_REGION)
    return writer.message()


def encode_imu(seen: Attitude, header: bytes) -> bytes:
    """The inverse of `decode_imu`, with the header of its sensor: nothing but an orientation."""
    covariance = (seen.sigma**2, *(0.0, 0.0, 0.0, seen.sigma**2) * 2)
    nothing = (0.0, 0.0, 0.0, *_UNKNOWN)
    turn = seen.x, seen.y, seen.z, seen.w
    return stamped_doubles(header, *turn, *covariance, *nothing, *nothing)


InfoT = TypeVar('InfoT')
ImageT = TypeVar('ImageT')

MAX_HELD = 5  # Images held back at a time
_MAX_IN_VAIN = 3
_MAX_INFOS = 2000
_MAX_LATE_NS = 250_000_000
"""Of a message behind a later one on its topic, as best effort has them."""
_MAX_GAP_NS = 250_000_000
"""Between two attitudes, for one in between to be interpolated."""
_MAX_AGE_NS = 50_000_000  # Of an attitude after which none has come: older ones are stale


class _Pairing(Generic[InfoT, ImageT]):
    """Holds an image back until what belongs to it has come: results do not depend on the order.

    Where some images in a row have waited in vain, those after them go on at once, until enough in
    a row find what belongs to them again.
    """

    _enough = 1

    def __init__(self) -> None:
        self._images: deque[tuple[int, ImageT]] = deque()
        self._infos: deque[tuple[int, InfoT]] = deque(maxlen=_MAX_INFOS)
        self._in_vain = self._found = 0

    @property
    def is_idle(self) -> bool:
        """Whether images go on at once, as they are: none waits, and nothing has come for them."""
        return self._in_vain == _MAX_IN_VAIN and not self._images and not self._infos

    @property
    def held(self) -> ImageT | None:
        """The image that has waited longest."""
        return self._images[0][1] if self._images else None

    def add_info(self, stamp_ns: int, info: InfoT) -> None:
        """Take what belongs to images of a stamp, ns."""
        newest_ns = self._infos[-1][0] if self._infos else stamp_ns
        if stamp_ns < newest_ns - _MAX_LATE_NS:
            # Time has jumped back, as in a bag that loops.
            self._infos.clear()
        self._infos.append((stamp_ns, info))
        if stamp_ns < newest_ns:
            self._infos = deque(sorted(self._infos, key=itemgetter(0)), _MAX_INFOS)

    def add_image(self, stamp_ns: int, image: ImageT) -> None:
        """Take an image with its stamp, ns."""
        self._images.append((stamp_ns, image))

    def take(self, *, wait: bool) -> tuple[InfoT | None, ImageT] | None:
        """The next image that need not be held back, and what belongs to it, if that is known.

        Unless more may yet come, and it is to wait for it, the first image goes as it is.
        """
        if not self._images:
            return None
        stamp_ns, image = self._images[0]
        if self._has_come(stamp_ns):
            self._found += 1
            if self._found >= self._enough:
                self._in_vain = 0
        elif wait and self._in_vain < _MAX_IN_VAIN and len(self._images) <= MAX_HELD:
            return None
        else:
            self._in_vain, self._found = min(self._in_vain + 1, _MAX_IN_VAIN), 0
        self._images.popleft()
        return self._at(stamp_ns), image

    def _has_come(self, stamp_ns: int) -> bool:
        raise NotImplementedError

    def _at(self, stamp_ns: int) -> InfoT | None:
        raise NotImplementedError


class StampPairing(_Pairing[InfoT, ImageT]):
    """Holds an image back until the calibration of its own stamp has come.

    An image goes with the newest calibration that is not later than it, as soon as one of its own
    stamp or a later one has come. A calibration may be published once, or now and then. From its
    arrival on one holds without a stamp (0), or where all are later: their clock is another one.
    """

    # Of one now and then, the images after each would wait for theirs.
    _enough = 2

    def __init__(self) -> None:
        super().__init__()
        self._current: InfoT | None = None
        self._newest_ns = 0

    @property
    def is_idle(self) -> bool:
        """Whether images go on at once, as they are: none waits, and no calibration has come."""
        return super().is_idle and self._current is None

    def add_info(self, stamp_ns: int, info: InfoT) -> None:
        """Take a calibration with its stamp, ns."""
        if stamp_ns:
            super().add_info(stamp_ns, info)
        else:
            self._current = info

    def add_image(self, stamp_ns: int, image: ImageT) -> None:
        """Take an image with its stamp, ns."""
        if self._newest_ns == 0 and self._infos and not self._images:
            self._current = self._infos[-1][1]
        super().add_image(stamp_ns, image)

    def _has_come(self, stamp_ns: int) -> bool:
        while self._infos and self._infos[0][0] <= stamp_ns:
            self._newest_ns, self._current = self._infos.popleft()
        return bool(self._infos) or self._newest_ns == stamp_ns

    def _at(self, stamp_ns: int) -> InfoT | None:
        return self._current


class AttitudePairing(_Pairing[Attitude, ImageT]):
    """Holds an image back until an attitude of its stamp or a later one has come.

    An image without one goes with None before the first message, and with `UNKNOWN_ATTITUDE` after.
    """

    def _has_come(self, stamp_ns: int) -> bool:
        return bool(self._infos) and self._infos[-1][0] >= stamp_ns

    def _at(self, stamp_ns: int) -> Attitude | None:
        place = bisect_left(self._infos, stamp_ns, key=itemgetter(0))
        if place < len(self._infos):
            before, after = self._infos[max(place - 1, 0)], self._infos[place]
            return after[1] if after[0] == stamp_ns else _between(before, after, stamp_ns)
        if not self._infos:
            return None
        newest_ns, newest = self._infos[-1]
        return newest if stamp_ns - newest_ns <= _MAX_AGE_NS else UNKNOWN_ATTITUDE


def _between(before: tuple[int, Attitude], after: tuple[int, Attitude], stamp_ns: int) -> Attitude:
    """Interpolated linearly; attitudes a quarter of a second apart are near each other."""
    one, other = before[1], after[1]
    gap = after[0] - before[0]
    if not (one.valid and other.valid and 0 < gap <= _MAX_GAP_NS):
        return UNKNOWN_ATTITUDE
    share = (stamp_ns - before[0]) / gap
    first, second = (one.x, one.y, one.z, one.w), (other.x, other.y, other.z, other.w)
    # Opposite quaternions are the same attitude.
    sign = 1.0 if sum(a * b for a, b in zip(first, second, strict=True)) >= 0 else -1.0
    mixed = [a + share * (sign * b - a) for a, b in zip(first, second, strict=True)]
    length = math.hypot(*mixed)
    x, y, z, w = (value / length for value in mixed)
    return Attitude(x, y, z, w, max(one.sigma, other.sigma), sensor=other.sensor)

"""Images and the attitude at their stamps, in whatever order images and attitudes come."""

from __future__ import annotations

import math
from collections import deque
from typing import Generic, TypeVar

from mvuav_ros.vision.approach.attitude import Attitude

ImageT = TypeVar('ImageT')

MOST_HELD = 5
"""Images held back at a time."""
_MOST_IN_VAIN = 3
_MOST_SAMPLES = 2000
_WIDEST_GAP_NS = 250_000_000
"""Between two attitudes, for one in between to be interpolated."""
_OLDEST_NS = 50_000_000
"""Of an attitude after which none has come: older ones are stale."""


class AttitudePairing(Generic[ImageT]):
    """Holds an image back until an attitude of its stamp or a later one has come.

    So the attitude of an image is the same, live or from a bag, whatever came first. Where some
    images in a row have waited in vain, those after them go on at once until attitudes come again.
    """

    def __init__(self) -> None:
        self._images: deque[tuple[int, ImageT]] = deque()
        self._samples: deque[tuple[int, Attitude | None]] = deque(maxlen=_MOST_SAMPLES)
        self._in_vain = 0

    @property
    def is_idle(self) -> bool:
        """Whether images go on at once, as they are: none waits, and no attitude has come."""
        return self._in_vain == _MOST_IN_VAIN and not self._images and not self._samples

    @property
    def held(self) -> ImageT | None:
        """The image that has waited longest."""
        return self._images[0][1] if self._images else None

    def add_attitude(self, stamp_ns: int, attitude: Attitude | None) -> None:
        """Take an attitude with its stamp, ns; None where a sensor said that it knows none."""
        if self._samples and stamp_ns < self._samples[-1][0]:
            # Time has jumped back, as in a bag that loops.
            self._samples.clear()
        self._samples.append((stamp_ns, attitude))

    def add_image(self, stamp_ns: int, image: ImageT) -> None:
        """Take an image with its stamp, ns."""
        self._images.append((stamp_ns, image))

    def take(self, *, wait: bool) -> tuple[Attitude | None, ImageT] | None:
        """The next image that need not be held back, and its attitude, if that is known.

        Args:
            wait: whether a later attitude may yet come; otherwise the first image goes as it is.
        """
        if not self._images:
            return None
        stamp_ns, image = self._images[0]
        if self._samples and self._samples[-1][0] >= stamp_ns:
            self._in_vain = 0
        elif wait and self._in_vain < _MOST_IN_VAIN and len(self._images) <= MOST_HELD:
            return None
        else:
            self._in_vain = min(self._in_vain + 1, _MOST_IN_VAIN)
        self._images.popleft()
        return self._at(stamp_ns), image

    def _at(self, stamp_ns: int) -> Attitude | None:
        before: tuple[int, Attitude | None] | None = None
        for sample in self._samples:
            if sample[0] == stamp_ns:
                return sample[1]
            if sample[0] > stamp_ns:
                return None if before is None else _between(before, sample, stamp_ns)
            before = sample
        if before is None or stamp_ns - before[0] > _OLDEST_NS:
            return None
        return before[1]


def _between(
    before: tuple[int, Attitude | None], after: tuple[int, Attitude | None], stamp_ns: int
) -> Attitude | None:
    """Interpolated linearly; attitudes a quarter of a second apart are near each other."""
    one, other = before[1], after[1]
    gap = after[0] - before[0]
    if one is None or other is None or gap > _WIDEST_GAP_NS:
        return None
    share = (stamp_ns - before[0]) / gap
    first, second = (one.x, one.y, one.z, one.w), (other.x, other.y, other.z, other.w)
    # Opposite quaternions are the same attitude.
    sign = 1.0 if sum(a * b for a, b in zip(first, second, strict=True)) >= 0 else -1.0
    mixed = [a + share * (sign * b - a) for a, b in zip(first, second, strict=True)]
    length = math.hypot(*mixed)
    return Attitude(*(value / length for value in mixed)) if length > 0 else None

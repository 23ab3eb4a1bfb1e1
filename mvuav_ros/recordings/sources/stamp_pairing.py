"""Images and the calibrations that belong to them, in whatever order the two come."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

InfoT = TypeVar('InfoT')
ImageT = TypeVar('ImageT')

MOST_HELD = 5
"""Images held back at a time."""
_MOST_IN_VAIN = 3
_MOST_INFOS = 50


class StampPairing(Generic[InfoT, ImageT]):
    """Holds an image back until the calibration of its own stamp has come.

    A camera's driver publishes the two with one stamp, in either order and on topics that do not
    wait for each other. An image goes with the newest calibration that is not later than it, as
    soon as one of its own stamp or a later one has come: so the results do not depend on what
    came first, live or from a bag. Where some images in a row have waited in vain (a calibration
    that is published once, or now and then) those after them go on at once, until a calibration
    comes with its image again. A calibration without a stamp (0) holds from its arrival on.
    """

    def __init__(self) -> None:
        self._images: deque[tuple[int, ImageT]] = deque()
        self._infos: deque[tuple[int, InfoT]] = deque()
        self._current: InfoT | None = None
        self._newest_ns = 0
        self._in_vain = 0

    @property
    def is_idle(self) -> bool:
        """Whether images go on at once, as they are: none waits, and no calibration has come."""
        return (
            self._in_vain == _MOST_IN_VAIN
            and not self._images
            and not self._infos
            and self._current is None
        )

    @property
    def held(self) -> ImageT | None:
        """The image that has waited longest."""
        return self._images[0][1] if self._images else None

    def add_info(self, stamp_ns: int, info: InfoT) -> None:
        """Take a calibration with its stamp, ns."""
        if stamp_ns == 0:
            self._current = info
            return
        if self._infos and stamp_ns < self._infos[-1][0]:
            # Time has jumped back, as in a bag that loops.
            self._infos.clear()
        self._infos.append((stamp_ns, info))
        if len(self._infos) > _MOST_INFOS:
            self._newest_ns, self._current = self._infos.popleft()

    def add_image(self, stamp_ns: int, image: ImageT) -> None:
        """Take an image with its stamp, ns."""
        self._images.append((stamp_ns, image))

    def take(self, *, wait: bool) -> tuple[InfoT | None, ImageT] | None:
        """The next image that need not be held back, and its calibration, if there is one.

        Args:
            wait: whether the calibration may yet come; otherwise the first image goes as it is.
        """
        if not self._images:
            return None
        stamp_ns, image = self._images[0]
        while self._infos and self._infos[0][0] <= stamp_ns:
            self._newest_ns, self._current = self._infos.popleft()
        if self._infos or self._newest_ns == stamp_ns:
            self._in_vain = 0
        elif wait and self._in_vain < _MOST_IN_VAIN and len(self._images) <= MOST_HELD:
            return None
        else:
            self._in_vain = min(self._in_vain + 1, _MOST_IN_VAIN)
        self._images.popleft()
        return self._current, image

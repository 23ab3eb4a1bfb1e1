"""What the marker programs find: labelled markers and one frame's result."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Label(IntEnum):
    """The tanker's five markers in the order of the results; UNLABELLED for any other light."""

    LEFT_WING = 0
    LEFT_STABILIZER = 1
    RUDDER = 2
    RIGHT_STABILIZER = 3
    RIGHT_WING = 4
    UNLABELLED = 255


TANKER_LABELS = tuple(Label)[: Label.RIGHT_WING + 1]
TANKER_NAMES = tuple(label.name.lower() for label in TANKER_LABELS)


class MarkerState(IntEnum):
    """What is known of a marker in this frame."""

    LOST = 0
    DETECTED = 1
    PREDICTED = 2


class Window(NamedTuple):
    """A search window, inclusive pixel bounds, already clipped to the image (may be empty)."""

    x0: int
    x1: int
    y0: int
    y1: int

    @classmethod
    def around(cls, x: float, y: float, radius: int, size: tuple[int, int]) -> Window:
        """2 radius + 1 px on a side around any position, in an image of a size (all px)."""
        if not (-FAR_OFF < x < FAR_OFF and -FAR_OFF < y < FAR_OFF):
            return NO_WINDOW
        # Stamps of whole ns make equal steps unequal: a hair below a half is rounded up as well.
        column, row = math.floor(x + 0.50001), math.floor(y + 0.50001)
        x0, x1, y0, y1 = column - radius, column + radius, row - radius, row + radius
        right, bottom = size[0] - 1, size[1] - 1
        # Conditions, as min and max take several times as long.
        return cls(
            x0 if x0 > 0 else 0,
            x1 if x1 < right else right,
            y0 if y0 > 0 else 0,
            y1 if y1 < bottom else bottom,
        )


NO_WINDOW = Window(0, -1, 0, -1)
FAR_OFF = 1e6  # px, beyond which a prediction says nothing


class Marker(NamedTuple):
    """One marker in one frame, px, px/s and px/s²; whatever is not known is NaN.

    ``label`` is a `Label` for the tanker, the place in the rig for any other body, and
    `Label.UNLABELLED` in ``detect_any`` and ``track_any``. ``confidence`` is the probability of the
    name; NaN of lights without one, of markers that are not detected, and where the thesis's
    assumptions give the names.
    """

    label: int
    state: MarkerState
    x: float = math.nan
    y: float = math.nan
    vx: float = math.nan
    vy: float = math.nan
    ax: float = math.nan
    ay: float = math.nan
    area: float = math.nan
    confidence: float = math.nan


LOST_TANKER = tuple(Marker(label, MarkerState.LOST) for label in TANKER_LABELS)


@dataclass(frozen=True, slots=True)
class MarkerResult:
    """One frame's markers.

    Attributes:
        markers: a row for each of the rig's, in its order (the tanker's: `TANKER_LABELS`), or for
            each light in ``detect_any`` and ``track_any``.
        roll: radians, right wing down positive; NaN while either wing is lost.
        status: empty when all is well, else what is missing, in words.
        windows: the windows searched, in the markers' order; empty where the frame was searched
            whole.
        predictions: where each marker was expected before the frame was looked at, px, in the
            markers' order; NaN where nothing was known, empty where nothing was predicted.
        has_wings: whether the body has a left_wing and a right_wing, which make the roll.
        ids: in ``track_any`` each light's number, from 1 up and never given twice; else empty.
        camera_doubt: why the camera's calibration is not believed, in words; empty if it is, or if
            there is none. A pose by it would be wrong.
    """

    markers: tuple[Marker, ...]
    roll: float = math.nan
    status: str = ''
    windows: tuple[Window, ...] = ()
    predictions: tuple[tuple[float, float], ...] = ()
    has_wings: bool = True
    ids: tuple[int, ...] = ()
    camera_doubt: str = ''

    @property
    def named(self) -> list[Marker]:
        """The markers that were seen and have names."""
        return [
            marker
            for marker in self.markers
            if marker.state is MarkerState.DETECTED and marker.label != Label.UNLABELLED
        ]

    def remarked(self, remark: str) -> MarkerResult:
        """The same with a remark behind the status; an empty one, or a known one, says nothing."""
        if not remark or remark in self.status:
            return self
        return replace(self, status='; '.join(filter(None, (self.status, remark))))


WINGS = ('left_wing', 'right_wing')


def labels_of(names: Sequence[str]) -> Sequence[int]:
    """The labels of a rig's markers."""
    return TANKER_LABELS if tuple(names) == TANKER_NAMES else range(len(names))


def all_lost(names: Sequence[str], status: str) -> MarkerResult:
    """The result in which none of a rig's markers is known, and why."""
    lost = tuple(Marker(label, MarkerState.LOST) for label in labels_of(names))
    return MarkerResult(lost, status=status, has_wings={*WINGS} <= {*names})


def is_cut(marker: Marker, size: tuple[int, int]) -> bool:
    """Whether the border of an image of a size (px) cuts a detected light off."""
    width, height = size
    radius = math.sqrt(marker.area / math.pi)
    across = radius <= marker.x <= width - 1 - radius
    return not (across and radius <= marker.y <= height - 1 - radius)


def named_places(
    result: MarkerResult, size: tuple[int, int]
) -> tuple[list[int], NDArray[np.float64]]:
    """Labels and places (n, 2), px, of the markers that were seen whole in an image of a size."""
    seen = [marker for marker in result.named if not is_cut(marker, size)]
    places = np.array([(marker.x, marker.y) for marker in seen]).reshape(-1, 2)
    return [int(marker.label) for marker in seen], places


def roll_of(left: Marker, right: Marker) -> float:
    """Roll from the wings (rad), right wing down positive; NaN while either is lost."""
    return math.atan2(right.y - left.y, right.x - left.x)


def counts_of(markers: Sequence[Marker]) -> str:
    """How many are in each state, in words."""
    counts = Counter(marker.state for marker in markers)
    return ', '.join(
        f'{counts[state]} {state.name.lower()}' for state in MarkerState if counts[state]
    )

"""What the approach pipeline says about one frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.point_operations import Pixels
from mvuav_ros.vision.runway.results import LineRole, RunwayLine

ROLES = (
    LineRole.LEFT_EDGE,
    LineRole.RIGHT_EDGE,
    LineRole.CENTRELINE,
    LineRole.FAR_END,
    LineRole.NEAR_END,
)
"""Of the rows of `ApproachResult.lines`."""

UNKNOWN_VARIANCE = 1e12
"""m² and rad²: of what was not observed."""

Point = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Guidance:
    """The camera in the runway's frame; NaN with `UNKNOWN_VARIANCE` where it was not observed.

    The runway's frame: origin on the centreline at the near end, x along the centreline towards
    the far end, y left, z up.

    Attributes:
        x: m; minus the distance to the near end, known while that is in sight.
        y: m; lateral offset.
        z: m; height.
        roll: rad, right wing down positive.
        pitch: rad, nose down positive.
        yaw: rad, heading error, nose left positive.
        covariance: (6, 6) of x, y, z, roll, pitch, yaw.
    """

    x: float = math.nan
    y: float = math.nan
    z: float = math.nan
    roll: float = math.nan
    pitch: float = math.nan
    yaw: float = math.nan
    covariance: NDArray[np.float64] = field(default_factory=lambda: UNKNOWN_VARIANCE * np.eye(6))

    @property
    def known(self) -> bool:
        """Whether anything was observed."""
        return math.isfinite(self.y)


@dataclass(frozen=True, eq=False)
class ApproachResult:
    """One frame's result; all positions are px on the frame.

    Attributes:
        stamp_ns: the frame's time, ns.
        width: of the frame, px.
        height: of the frame, px.
        lines: one row for each of `ROLES`.
        vanishing_point: where the edges meet; NaN without a shape.
        horizon: two points of the horizon at the sides of the frame, if it was seen.
        corners: of the shape: near left, near right, far right, far left; none without a shape.
        confidence: of the shape, 0 to 1; 0 without one.
        guidance: None unless it was asked for.
        status: empty, or why there is no shape.
        image: the frame as it was given, for the overlay.
    """

    stamp_ns: int
    width: int
    height: int
    lines: tuple[RunwayLine, ...]
    vanishing_point: Point = (math.nan, math.nan)
    horizon: tuple[Point, Point] | None = None
    corners: tuple[Point, Point, Point, Point] | None = None
    confidence: float = 0.0
    guidance: Guidance | None = None
    status: str = field(kw_only=True)
    image: Pixels = field(kw_only=True)

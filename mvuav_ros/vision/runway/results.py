"""What the runway detector says about one frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import NamedTuple

from mvuav_ros.vision.point_operations import Mask, Pixels
from mvuav_ros.vision.runway.hough import Accumulator, HoughGrid
from mvuav_ros.vision.runway.normal_form import NormalForm
from mvuav_ros.vision.runway.peaks import Peak


class LineFlag(IntFlag):
    """The bits of `RunwayLine.flags`."""

    RHO_ERROR = 1
    THETA_ERROR = 2
    CORRECTED = 4


class LineRole(IntEnum):
    """Which line of the runway a row is."""

    UNKNOWN = 0
    LEFT_EDGE = 1
    RIGHT_EDGE = 2
    CENTRELINE = 3
    FAR_END = 4
    NEAR_END = 5


class RunwayLine(NamedTuple):
    """One row of the result; a row without a peak holds NaN everywhere and no flag.

    All positions are on the whole frame, (0, 0) the centre of its top-left pixel.

    Attributes:
        peak: index of the row's peak, strongest first, or None.
        rho: px, after correction; x cos(theta) + y sin(theta) = rho.
        theta: rad, in (-pi/2, pi/2], after correction.
        votes: of the peak.
        rho_raw: px, of the peak.
        theta_raw: rad, of the peak.
        rho_flag: rho jumped.
        theta_flag: theta jumped.
        x: of the segment's upper end, px; NaN where the line misses the frame, as all ends are.
        y: of the upper end, px.
        x2: of the lower end, px.
        y2: of the lower end, px.
        role: which line it is; the thesis's scheme does not know.
        confidence: 0 to 1; NaN where none is estimated.
    """

    peak: int | None = None
    rho: float = math.nan
    theta: float = math.nan
    votes: float = math.nan
    rho_raw: float = math.nan
    theta_raw: float = math.nan
    rho_flag: bool = False
    theta_flag: bool = False
    x: float = math.nan
    y: float = math.nan
    x2: float = math.nan
    y2: float = math.nan
    role: LineRole = LineRole.UNKNOWN
    confidence: float = math.nan

    @property
    def found(self) -> bool:
        """A peak belongs to this row."""
        return self.peak is not None

    @property
    def corrected(self) -> bool:
        """Rho and theta are old values, kept because a flag was raised."""
        return self.rho_flag or self.theta_flag

    @property
    def flags(self) -> LineFlag:
        """The flags as bits: 1 rho error, 2 theta error, 4 corrected."""
        return LineFlag(self.rho_flag + 2 * self.theta_flag + 4 * self.corrected)

    @property
    def raw(self) -> NormalForm:
        """The peak's line."""
        return NormalForm(self.rho_raw, self.theta_raw)


@dataclass(frozen=True, eq=False)
class RunwayWorkings:
    """The arrays that a frame went through, for the debug images; None where it did not get to."""

    image: Pixels  # as it was given: (height, width) or (height, width, 3), blue first
    gray: Pixels | None = None  # the confined channel, (rows, width)
    edges: Mask | None = None  # opened, (rows, width), 0 or 1
    grid: HoughGrid | None = None  # cells of the accumulator
    peaks: tuple[Peak, ...] = ()  # strongest first
    peak_reach: tuple[int, int] = (0, 0)  # cells of a neighbourhood to each side, rho and theta

    @property
    def accumulator(self) -> Accumulator | None:
        """Votes, (theta, rho from the grid's `first_reachable_cell` on), counted when asked for."""
        if self.edges is None or self.grid is None:
            return None
        return self.grid.accumulate(self.edges)


@dataclass(frozen=True, eq=False)
class RunwayResult:
    """One frame's result.

    Attributes:
        stamp_ns: the frame's time, ns.
        width: of the frame, px.
        height: of the frame, px.
        rows: first row searched and the row after the last one; equal where none was.
        lines: exactly ``num_peaks`` rows.
        status: empty, or why no line was found or not all rows asked for were searched.
        workings: for the debug images of `overlay`. They share memory with the frame given to
            the detector: draw them before that is overwritten.
    """

    stamp_ns: int
    width: int
    height: int
    rows: tuple[int, int]
    lines: tuple[RunwayLine, ...]
    status: str
    workings: RunwayWorkings

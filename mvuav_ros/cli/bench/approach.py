"""Mode approach over a synthetic flight, held against the frame rates that it must keep."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.cli.bench.case import Action, Case
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.vision.approach.detector import ApproachDetector

_FRAMES = 40
_LIMITS = {(320, 240): 1e3 / 200, (1280, 720): 1e3 / 60}
"""Width and height, px, to ms per frame."""


def approach_cases() -> list[Case]:
    """One case for each size with a limit; one OpenCV thread is the caller's to set."""
    return [
        Case(
            f'approach {width}x{height}',
            _detector(_flight(width, height)),
            limit_ms=limit,
            note=f'at least {1e3 / limit:.0f} frames/s',
        )
        for (width, height), limit in _LIMITS.items()
    ]


def _detector(frames: list[NDArray[np.uint8]]) -> Action:
    detector = ApproachDetector(RunwayDetectorParameters(mode='approach'))
    # There and back, so that nothing jumps.
    endless = itertools.cycle([*frames, *reversed(frames)])
    return lambda: detector.process(next(endless), 0)


def _flight(width: int, height: int) -> list[NDArray[np.uint8]]:
    from mvuav_ros.simulation.runway import RunwayFlight
    from mvuav_ros.simulation.settings import RunwaySettings

    flight = RunwayFlight(RunwaySettings(width=width, height=height, frames=_FRAMES))
    return [flight.frame(index).image.pixels for index in range(_FRAMES)]

"""Synthetic flights and mode approach over one, held against the rates that they must keep."""

from __future__ import annotations

import itertools
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.cli.bench.case import Case
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.simulation.flight import Flight
from mvuav_ros.simulation.runway_flight import RunwayFlight
from mvuav_ros.simulation.settings import RunwaySettings, TankerSettings
from mvuav_ros.simulation.tanker_flight import TankerFlight
from mvuav_ros.vision.approach.detector import ApproachDetector

_APPROACH_FRAMES, _APPROACH_RATES = 40, {(320, 240): 200, (1280, 720): 60}
"""Width and height, px, to frames per second."""
_SIMULATED_FRAMES, _SIMULATED_RATE = 100, 60


def approach_cases() -> list[Case]:
    """One case for each size with a limit; one OpenCV thread is the caller's to set."""
    return [_approach(width, height, rate) for (width, height), rate in _APPROACH_RATES.items()]


def _approach(width: int, height: int, rate: int) -> Case:
    detector = ApproachDetector(RunwayDetectorParameters(mode='approach'))
    flight = RunwayFlight(RunwaySettings(width=width, height=height, frames=_APPROACH_FRAMES))
    frames = [flight.frame(index).image.pixels for index in range(_APPROACH_FRAMES)]
    # There and back, so that nothing jumps.
    endless = itertools.cycle([*frames, *reversed(frames)])
    same = itertools.cycle([*frames, *reversed(frames)])
    return Case(
        f'approach {width}x{height}',
        lambda: detector.process(next(endless), 0),
        'OpenCV lines',
        lambda: _opencv_lines(next(same)),
        limit_ms=1e3 / rate,
        note=f'at least {rate} frames/s',
    )


def _opencv_lines(frame: NDArray[np.uint8]) -> object:
    """What OpenCV takes for the lines alone: Canny and HoughLinesP, on 320 px of width."""
    gray = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
    factor = max(1, round(gray.shape[1] / 320))
    if factor > 1:
        size = (gray.shape[1] // factor, gray.shape[0] // factor)
        gray = np.asarray(cv2.resize(gray, size, interpolation=cv2.INTER_AREA), np.uint8)
    edges = cv2.Canny(gray, 60, 150)
    return cv2.HoughLinesP(edges, 1, np.pi / 180, 40, minLineLength=20, maxLineGap=5)


def simulation_cases() -> list[Case]:
    """One case for each kind of flight; one OpenCV thread is the caller's to set."""
    size: dict[str, Any] = {'width': 640, 'height': 480, 'frames': _SIMULATED_FRAMES}
    docking = TankerSettings(motion='docking', encoding='bgr8', **size)
    flights: dict[str, Flight[Any]] = {
        'tanker, mono8': TankerFlight(TankerSettings(**size)),
        'docking, bgr8': TankerFlight(docking),
        'runway, bgr8': RunwayFlight(RunwaySettings(**size)),
    }
    return [_simulation(name, flight) for name, flight in flights.items()]


def _simulation(name: str, flight: Flight[Any]) -> Case:
    indices = itertools.cycle(range(_SIMULATED_FRAMES))
    return Case(
        f'simulated 640x480 {name}',
        lambda: flight.frame(next(indices)),
        limit_ms=1e3 / _SIMULATED_RATE,
        note=f'at least {_SIMULATED_RATE} frames/s',
    )

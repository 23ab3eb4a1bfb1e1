"""The simulator's images with their truth, held against the rate that it must keep."""

from __future__ import annotations

import itertools
from typing import Any

from mvuav_ros.cli.bench.case import Case
from mvuav_ros.simulation.flight import Flight
from mvuav_ros.simulation.runway import RunwayFlight
from mvuav_ros.simulation.settings import RunwaySettings, TankerSettings
from mvuav_ros.simulation.tanker import TankerFlight

_FRAMES = 100
_RATE = 60
_SIZE: dict[str, Any] = {'width': 640, 'height': 480, 'frames': _FRAMES}


def simulation_cases() -> list[Case]:
    """One case for each kind of flight; one OpenCV thread is the caller's to set."""
    return [
        _case('tanker, mono8', TankerFlight(TankerSettings(**_SIZE))),
        _case(
            'docking, bgr8',
            TankerFlight(TankerSettings(motion='docking', encoding='bgr8', **_SIZE)),
        ),
        _case('runway, bgr8', RunwayFlight(RunwaySettings(**_SIZE))),
    ]


def _case(name: str, flight: Flight[Any]) -> Case:
    indices = itertools.cycle(range(_FRAMES))
    return Case(
        f'simulated 640x480 {name}',
        lambda: flight.frame(next(indices)),
        limit_ms=1e3 / _RATE,
        note=f'at least {_RATE} frames/s',
    )

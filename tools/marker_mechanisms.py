"""Mechanisms of naming that can be switched off alone, to see what each of them is for."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from mvuav_ros.vision.markers import (
    calibrated_tracker,
    identity_tracker,
    initialization,
    lamps,
    marker_memory,
    naming,
    view_filter,
)
from mvuav_ros.vision.markers.fault_detection import FaultDetector
from mvuav_ros.vision.markers.marker_memory import Jumps, MarkerMemory
from mvuav_ros.vision.markers.naming import Clutter, Search
from mvuav_ros.vision.markers.view_filter import ViewFilter


def _returns(value: Any) -> Callable[..., Any]:
    return lambda *arguments, **options: value


WITHOUT: dict[str, list[tuple[Any, str, Any]]] = {
    'jumps': [(Jumps, 'update', _returns(None))],
    'trusting again': [(MarkerMemory, 'trust_again', _returns(None))],
    'joined lights': [(Search, '_name_joined', _returns(None))],
    'newcomers first': [(naming, 'GATE_OF_FEW', math.inf), (naming, 'GATE', math.inf)],
    'distrust': [(MarkerMemory, 'distrust', _returns({}))],
    'probation': [(marker_memory, 'PROBATION', 0)],
    'longer probation where nothing checks': [(marker_memory, 'UNCHECKED', 15)],
    'names in doubt withheld': [
        (marker_memory, 'MIN_ODDS', -math.inf),
        (naming, 'MIN_ODDS', -math.inf),
    ],
    'doubt only with clutter': [(Clutter, 'is_about', property(_returns(True)))],
    'clutter at any place': [(marker_memory, 'STRANGE_DENSITY', (0.0, 0.0))],
    'a steady residual': [(initialization, 'SAME_RESIDUAL', (math.inf, math.inf))],
    'sure place': [(marker_memory, 'SURE_PLACE', 0.0)],
    'returning': [(marker_memory, 'RETURNING', 0)],
    'clutter by age': [(Clutter, 'include', lambda _, lights: np.zeros(len(lights), bool))],
    'suspects by evidence': [(FaultDetector, '_without_suspects', _returns(None))],
    'bank': [(view_filter, 'BENDING', (1, 0))],
    'process noise': [(ViewFilter, '_learn_motion', _returns(None))],
    'rig error': [(ViewFilter, '_learn_rig_error', _returns(None))],
    # Not 3: that many frames ask uncertain bodies, which would count as odd ones.
    'odd start': [(initialization, 'CONFIRMED_ODD', 4)],
    'search by an older filter': [(Search, '_find_otherwise', _returns(None))],
    'two lights': [(naming, 'MIN_REACQUIRED', (3, 3))],
    'hidden markers': [(naming, 'MAX_HIDDEN', 0)],
    'lamps': [(lamps, 'MIN_SEEN', math.inf)],
    'wider windows': [(identity_tracker, 'WIDEST', 0.0)],
    'learnt calibration': [(calibrated_tracker, 'AGREED', math.inf)],
}
"""Where it is, its name there, and what stands in for it."""


def switch_off(name: str) -> None:
    """Switch some off for the rest of this process, their names with commas between them."""
    for one in name.split(','):
        for place, attribute, value in WITHOUT[one]:
            assert hasattr(place, attribute), (place, attribute)
            setattr(place, attribute, value)

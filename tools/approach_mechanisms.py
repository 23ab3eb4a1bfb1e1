"""Mechanisms of mode approach that can be switched off alone, to see what each of them is for."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import ModuleType
from typing import Any

from mvuav_ros.vision.approach import track, tuning
from mvuav_ros.vision.approach.attitude import HorizonFinder
from mvuav_ros.vision.approach.ground_motion import GroundMotion, Overlaid, Registration
from mvuav_ros.vision.approach.strip_edges import EdgeLook


def _returns(value: Any) -> Callable[..., Any]:
    return lambda *arguments, **options: value


WITHOUT: dict[str, list[tuple[Any, str, Any]]] = {
    'overlays': [(Overlaid, 'take', _returns(None))],
    'grey levels': [(tuning.LEVELS, 'max_gain', 1.0)],
    'haze': [(tuning.HAZE, 'min_excess', math.inf)],
    'edges that stand still': [(GroundMotion, 'still_odds', _returns(-math.inf))],
    'weights from near by': [(tuning.TRACK, 'min_near_by', math.inf)],
    'search above the picture': [(tuning.DETECTOR, 'range_above', 0.03)],
    'rows outside of the picture': [
        (tuning.SEARCH, 'min_inside', 1.0),
        (tuning.SEARCH, 'last_first_row', tuning.SEARCH.first_row),
    ],
    'lines by what is in view': [(tuning.EDGES, 'min_seen', 1.0)],
    'doubt of shoulders that fades': [
        (tuning.TRACK, 'shoulder_memory', (*tuning.TRACK.shoulder_memory[:2], 0.0))
    ],
    'horizon in the image': [(HorizonFinder, 'find', _returns(None))],
    'doubt above the horizon': [(tuning.TRACKER, 'above_horizon_odds', 0.0)],
    'side lines': [(track, 'find_side_lines', _returns(None))],
    'line widths': [(tuning.LINES, 'half_widths', (0.06,))],
    'lines near the mean': [
        (tuning.LINES, 'away_cost', 0.0),
        (tuning.LINES, 'away_from_colour_cost', 0.0),
    ],
    "shoulders' lines": [(tuning.LINES, 'shoulder_cost', 0.0)],
    'edges alone': [(tuning.TRACK, 'lock_width', math.inf)],
    'shoulders': [(track, 'shows_shoulders', _returns(None))],
    'shoulders as plain': [(tuning.SHOULDERS, 'min_step_share', 0.0)],
    'edges on finer levels': [(tuning.SEARCH, 'finest_aligned', 9)],
    'lines in few rows': [(tuning.LINES, 'min_support', -1.0)],
    'steps farther off': [(tuning.EDGES, 'far_reach', 0.0)],
    'registration': [(Registration, 'shift', _returns((0.0, 0.0)))],
    'colour': [(EdgeLook, 'coloured', property(_returns(False)))],
    'clear colours': [(tuning.EDGES, 'clear_contrast', math.inf)],
    'steps of narrow runways': [(tuning.TRACK, 'wide', 0.0)],
    'kinds over many frames': [(tuning.TRACK, 'kind_leave', 1.0)],
    'mean of strips': [(tuning.TRACK, 'hot', (20.0, 0.02)), (tuning.TRACK, 'cold', (40.0, 0.02))],
    'third track': [(tuning.TRACKER, 'max_tracks', 2)],
    'weighed every sixth frame': [
        (tuning.TRACKER, 'best_period', 1),
        (tuning.TRACKER, 'others_period', 1),
        (tuning.TRACKER, 'period_certain', 1),
    ],
    'coarsest level': [(tuning.SEARCH, 'levels', 3)],
}
"""Where it is, its name there, and what stands in for it."""


def switch_off(name: str) -> None:
    """Switch one off for the rest of this process."""
    for place, attribute, value in WITHOUT[name]:
        assert hasattr(place, attribute), (place, attribute)
        if isinstance(place, type | ModuleType):
            setattr(place, attribute, value)
        else:
            # The constants are frozen.
            object.__setattr__(place, attribute, value)

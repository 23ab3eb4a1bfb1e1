"""Mechanisms of mode approach that can be switched off alone, to see what each of them is for."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from mvuav_ros.vision.approach.followed_strip import Shape
from mvuav_ros.vision.approach.overlaid import Overlaid
from mvuav_ros.vision.approach.registration import Registration
from mvuav_ros.vision.approach.runway import edge_track, probability, track
from mvuav_ros.vision.approach.runway.edge_track import EdgeTrack
from mvuav_ros.vision.approach.runway.edges import EdgeLook


def _returns(value: Any) -> Callable[..., Any]:
    return lambda *arguments, **options: value


WITHOUT: dict[str, tuple[Any, str, Any]] = {
    'overlays': (Overlaid, 'take', _returns(None)),
    'weights from near by': (probability, '_NEAR_BY', math.inf),
    'side lines': (EdgeTrack, '_lines_along', _returns(None)),
    'edges alone': (track, '_LOCK_WIDTH', math.inf),
    'shoulders': (edge_track, 'shows_shoulders', _returns(None)),
    'jumps': (EdgeTrack, '_watch', _returns(None)),
    'growth': (Shape, 'grow', _returns(None)),
    'registration': (Registration, 'shift', _returns((0.0, 0.0))),
    'colour': (EdgeLook, 'coloured', property(_returns(False))),
}
"""Where it is, its name there, and what stands in for it."""


def switch_off(name: str) -> None:
    """Switch one off for the rest of this process."""
    place, attribute, value = WITHOUT[name]
    setattr(place, attribute, value)

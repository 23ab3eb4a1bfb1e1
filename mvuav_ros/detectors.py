"""The detectors, each declared once: a line here makes a node, a replay and a page of the panel.

What a detector publishes, draws and shows stands in its `Processor`, what a user can set in its
parameters. Nothing is imported before it is used, as a process runs only some of them.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any, NamedTuple


class Detector(NamedTuple):
    """A node that looks at images."""

    word: str  # for the argument ``detectors`` of the launch files
    processor: str  # the module and class of its work
    parameters: str  # the module and class of what can be set
    sample: str = ''  # part of the names of recordings that show what it looks for


DETECTORS = {
    'marker_tracker': Detector(
        'markers',
        'processing.marker_processor:MarkerTrackerProcessor',
        'parameters.marker_tracker:MarkerTrackerParameters',
        sample='tanker',
    ),
    'runway_detector': Detector(
        'runway',
        'processing.runway_processor:RunwayDetectorProcessor',
        'parameters.runway_detector:RunwayDetectorParameters',
        sample='runway',
    ),
}
"""By the node's name, which is also that of its executable."""


def load_class(place: str) -> Any:
    """The class at a place of a `Detector`, such as ``processing.marker_processor:…``."""
    module, _, name = place.partition(':')
    return getattr(import_module(f'mvuav_ros.{module}'), name)

"""The marker tracker over a synthetic flight: what it predicted, found, and what was true."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.offline.evaluation.metrics import Array, angle_difference
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.simulation.settings import TankerSettings
from mvuav_ros.simulation.tanker_flight import TankerFlight
from mvuav_ros.vision.markers.results import MarkerResult, MarkerState
from mvuav_ros.vision.markers.tracker import MarkerTracker


@dataclass(frozen=True)
class MarkerTask:
    """A flight, and the parameters of each tracker that follows it, by a name of one's own."""

    flight: TankerSettings
    trackers: Mapping[str, MarkerTrackerParameters]


@dataclass(frozen=True, eq=False)
class MarkerRun:
    """One tracker's results, by frame and marker.

    Attributes:
        predicted: (n, 5, 2) px, where each marker was expected before its frame was seen; NaN
            where the whole frame was searched.
        found: (n, 5, 2) px, NaN unless detected.
        states: (n, 5), `MarkerState`.
        roll: (n,) rad.
    """

    predicted: Array
    found: Array
    states: NDArray[np.int_]
    roll: Array

    @property
    def prediction_error(self) -> Array:
        """Predicted minus found: what the thesis could measure, (n, 5, 2) px."""
        return self.predicted - self.found


@dataclass(frozen=True, eq=False)
class FlownMarkers:
    """All trackers' results on one flight, and its truth.

    Attributes:
        settings: of the flight.
        time: (n,) s.
        places: (n, 5, 2) px, true.
        roll: (n,) rad, true.
        runs: by the tracker's name.
    """

    settings: TankerSettings
    time: Array
    places: Array
    roll: Array
    runs: Mapping[str, MarkerRun]

    def found_error(self, name: str) -> Array:
        """Found minus true, (n, 5, 2) px."""
        return self.runs[name].found - self.places

    def predicted_error(self, name: str) -> Array:
        """Predicted minus true, (n, 5, 2) px."""
        return self.runs[name].predicted - self.places

    def roll_error(self, name: str) -> Array:
        """Measured minus true roll, (n,) rad."""
        return angle_difference(self.runs[name].roll, self.roll)


def fly_markers(task: MarkerTask) -> FlownMarkers:
    """Draw every frame once and show it to every tracker."""
    flight = TankerFlight(task.flight)
    trackers = {name: MarkerTracker(parameters) for name, parameters in task.trackers.items()}
    rows: dict[str, list[_Row]] = {name: [] for name in trackers}
    places, rolls = [], []
    for frame in flight:
        places.append([(marker.x, marker.y) for marker in frame.truth.markers])
        rolls.append(frame.truth.roll)
        for name, tracker in trackers.items():
            rows[name].append(_row(tracker.process(frame.image, frame.stamp_ns)))
    return FlownMarkers(
        task.flight,
        np.array([flight.time(index) for index in flight.indices]),
        np.array(places),
        np.array(rolls),
        {name: MarkerRun(*map(np.array, zip(*own, strict=True))) for name, own in rows.items()},
    )


_Place = tuple[float, float]
_Row = tuple[Sequence[_Place], Sequence[_Place], Sequence[MarkerState], float]


def _row(result: MarkerResult) -> _Row:
    """What a `MarkerRun` keeps of a frame."""
    nowhere = (math.nan, math.nan)
    states = [marker.state for marker in result.markers]
    found = [(m.x, m.y) if m.state is MarkerState.DETECTED else nowhere for m in result.markers]
    # A frame that is searched whole makes no use of a prediction.
    used = result.windows and result.predictions
    return result.predictions if used else [nowhere] * len(states), found, states, result.roll

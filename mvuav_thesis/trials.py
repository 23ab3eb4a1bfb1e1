"""The four trials of chapter 5.1, each flown several times: predicted, found and true."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.offline.evaluation.metrics import Array, angle_difference, distance_rms
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.simulation.settings import TRIALS, TankerSettings
from mvuav_ros.simulation.shake import VIBRATIONS
from mvuav_ros.simulation.tanker_flight import TankerFlight
from mvuav_ros.vision.markers.marker_results import MarkerResult, MarkerState
from mvuav_ros.vision.markers.thesis_tracker import WHOLE_FRAMES
from mvuav_ros.vision.markers.tracker import MarkerTracker
from mvuav_thesis.comparison import Interval, pooled_rms
from mvuav_thesis.plan import Plan, tracking_pipelines, words


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


@dataclass(frozen=True, eq=False)
class Trial:
    """One of the thesis's trials.

    Attributes:
        number: 1 to 4.
        flights: the same trial with other seeds; figures show the first.
    """

    number: int
    flights: tuple[FlownMarkers, ...]

    @property
    def motion(self) -> str:
        """How the tanker moves, in words."""
        return words(self.flights[0].settings.motion)

    @property
    def title(self) -> str:
        """Number and motion."""
        return f'Trial {self.number}: {self.motion}'

    @property
    def first(self) -> FlownMarkers:
        """The flight that figures show."""
        return self.flights[0]

    def errors(self, method: str) -> list[Interval]:
        """RMS of predicted minus found over all flights, px, by marker."""
        by_flight = [lengths(flight, method).T for flight in self.flights]
        return [pooled_rms(repeats) for repeats in zip(*by_flight, strict=True)]

    def rms(self, method: str) -> Array:
        """The same without the intervals."""
        return np.array([error.value for error in self.errors(method)])

    def pooled(self, method: str) -> float:
        """The same over all markers and flights."""
        return distance_rms(np.concatenate([f.runs[method].prediction_error for f in self.flights]))


def lengths(flight: FlownMarkers, method: str) -> Array:
    """Distance between predicted and found, (n, 5) px."""
    error = flight.runs[method].prediction_error
    return np.asarray(np.hypot(error[..., 0], error[..., 1]))


def tracking_tasks(plan: Plan) -> list[MarkerTask]:
    """The four trials without vibration, as often as planned, then once with each vibration."""
    steady = [(trial, 0, repeat) for trial in TRIALS for repeat in range(plan.trial_repeats)]
    shaken = [(trial, shake, 0) for trial in TRIALS for shake in range(1, len(VIBRATIONS))]
    return [MarkerTask(plan.trial(*which), tracking_pipelines()) for which in (*steady, *shaken)]


def trials_of(flown: Sequence[FlownMarkers]) -> tuple[list[Trial], list[FlownMarkers]]:
    """The trials on a steady camera, and one flight for each trial and vibration."""
    judged = [_after_start(flight) for flight in flown]
    steady = [flight for flight in judged if not flight.settings.shake]
    trials = [
        Trial(number, tuple(f for f in steady if f.settings.motion == motion))
        for number, motion in enumerate(TRIALS, 1)
    ]
    return trials, [flight for flight in judged if flight.settings.shake]


def _after_start(flight: FlownMarkers) -> FlownMarkers:
    """Without the predictions of the thesis's whole frames: all methods are judged by the same."""
    runs = {}
    for name, run in flight.runs.items():
        predicted = run.predicted.copy()
        predicted[:WHOLE_FRAMES] = np.nan
        runs[name] = replace(run, predicted=predicted)
    return replace(flight, runs=runs)

"""The four trials of chapter 5.1, each flown several times, and their errors of prediction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mvuav_ros.offline.evaluation.metrics import Array, distance_rms
from mvuav_ros.simulation.settings import TRIALS
from mvuav_ros.simulation.shake import VIBRATIONS
from mvuav_ros.vision.markers.thesis_tracker import WHOLE_FRAMES
from mvuav_thesis.marker_runs import FlownMarkers, MarkerTask
from mvuav_thesis.plan import Plan, tracking_pipelines, words
from mvuav_thesis.statistics_of_flights import Interval, pooled_rms


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

"""How much is flown and measured, and with which seeds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mvuav_ros.parameters.declaration import Value
from mvuav_ros.parameters.marker_tracker import PREDICTIONS, MarkerTrackerParameters
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.simulation.settings import RunwaySettings, TankerSettings
from mvuav_thesis import integrity_runs, known
from mvuav_thesis.comparison import SHIPPED
from mvuav_thesis.identity_runs import SCENES

METHODS = tuple(sorted(PREDICTIONS, key=lambda m: m == MarkerTrackerParameters().prediction))
"""Every method of prediction, the default last."""
RUNS = (*METHODS, SHIPPED)
PROGRAM_OF = {known.VELOCITY: 'velocity', known.FULL: 'acceleration_program'}
"""The method of prediction that the thesis measured under each name."""
PROGRAM = PROGRAM_OF[known.FULL]
"""Appendix C as coded: what the thesis calls full estimation."""


@dataclass(frozen=True)
class Plan:
    """The extent of the experiments; durations and rates are the thesis's.

    Attributes:
        seed: of all flights.
        jobs: processes.
        trial_seconds: length of each trial.
        trial_repeats: flights of each trial, which differ in their seeds.
        prediction_flights: of each kind of motion and frame rate.
        passes: how often each timed flight is processed.
        repeats: flights per cell of Table 5.5.
        measurements: of roll on each of those.
        runway_seconds: length of each runway scene.
        identity_scenes: how many of the scenes in which names can be lost.
        identity_repeats: flights of each of those.
        integrity_scenes: how many of the scenes in which other lights take the names.
        integrity_repeats: flights of each of those.
        pose_frames: frames of each docking approach.
    """

    seed: int = 2006
    jobs: int = 2
    trial_seconds: float = known.TRIAL_SECONDS
    trial_repeats: int = 5
    prediction_flights: int = 30
    passes: int = 3
    repeats: int = 5
    measurements: int = known.MEASUREMENTS
    runway_seconds: float = known.RUNWAY_SECONDS
    identity_scenes: int = len(SCENES)
    identity_repeats: int = 1
    integrity_scenes: int = len(integrity_runs.SCENES)
    integrity_repeats: int = 3
    pose_frames: int = 1000

    @classmethod
    def quick(cls, seed: int, jobs: int) -> Plan:
        """Enough to see that everything works; the numbers are rough."""
        return cls(
            seed=seed,
            jobs=jobs,
            trial_repeats=2,
            prediction_flights=2,
            passes=1,
            repeats=2,
            measurements=20,
            runway_seconds=1.5,
            identity_scenes=2,
            integrity_scenes=2,
            integrity_repeats=1,
            pose_frames=200,
        )

    @property
    def trial_frames(self) -> int:
        """Of each trial."""
        return round(self.trial_seconds * known.TRIAL_FPS)

    @property
    def runway_frames(self) -> int:
        """Of each runway scene."""
        return round(self.runway_seconds * known.RUNWAY_FPS)

    def seed_of(self, repeat: int) -> int:
        """The seed of a repeated flight."""
        return (self.seed + 1000 * repeat) % 2**31

    def trial(self, motion: str, shake: int = 0, repeat: int = 0) -> TankerSettings:
        """A trial's flight at 640x480 and 15 frames/s, as in the thesis."""
        return TankerSettings(
            motion=motion,
            fps=known.TRIAL_FPS,
            frames=self.trial_frames,
            seed=self.seed_of(repeat),
            shake=shake,
        )

    def runway(self, scene: Mapping[str, Value]) -> RunwaySettings:
        """A runway flight at 320x240 and 30 frames/s, as in the thesis."""
        size = {'width': 320, 'height': 240, 'fps': known.RUNWAY_FPS}
        given = {**size, 'frames': self.runway_frames, 'seed': self.seed, **scene}
        return RunwaySettings.from_mapping(given)


def tracker(**values: Value) -> MarkerTrackerParameters:
    """The marker tracker's parameters with the thesis's groups, centroid and channel."""
    given = {'grouping': 'distance', 'centroid': 'binary', 'channel': 'intensity', **values}
    return MarkerTrackerParameters.from_mapping(given)


def tracking_pipelines() -> dict[str, MarkerTrackerParameters]:
    """The parameters of each of `RUNS`."""
    by_method = {method: tracker(mode='track', prediction=method) for method in METHODS}
    return {**by_method, SHIPPED: MarkerTrackerParameters()}


def thesis_detector() -> RunwayDetectorParameters:
    """The runway detector's parameters of ``config/thesis.yaml``."""
    return RunwayDetectorParameters(start_row=49, peak_threshold=1, max_hold=0, association='index')


def words(name: str) -> str:
    """A parameter's choice as people write it."""
    return name.replace('_', ' ')

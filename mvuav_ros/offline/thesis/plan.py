"""How much is flown and measured, and with which seeds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from mvuav_ros.offline.evaluation.identity_runs import SCENES
from mvuav_ros.offline.evaluation.marker_runs import supported
from mvuav_ros.offline.tasks import all_of
from mvuav_ros.parameters.declaration import Value
from mvuav_ros.parameters.marker_tracker import PREDICTIONS, MarkerTrackerParameters
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters

TaskT = TypeVar('TaskT')
ResultT = TypeVar('ResultT')

SHIPPED = 'as shipped'
"""The marker tracker with its default parameters, beside the thesis's programs."""
METHODS = tuple(sorted(PREDICTIONS, key=lambda m: m == MarkerTrackerParameters().prediction))
"""Every method of prediction, the default last."""
RUNS = (*METHODS, SHIPPED)
THESIS_RUN = 'velocity'
"""Stands for the thesis's tracking where its results do not depend on the prediction."""
TRIAL_FPS = 15.0
"""As in the reference runs of the thesis's programs: half of a camera's 30, so the harder case."""
VIBRATION_FPS = 30.0


@dataclass(frozen=True)
class Plan:
    """The extent of the experiments.

    Attributes:
        seed: of all flights.
        jobs: processes.
        trial_frames: frames of each trial.
        passes: how often each timed flight is processed.
        timed_frames: frames of the timed flights.
        spectrum_seconds: length of the flights whose vibration is analysed.
        repeats: flights per cell of Table 5.5.
        runway_frames: frames of each runway scene.
        identity_scenes: how many of the scenes in which names can be lost.
        identity_repeats: flights of each of those.
        pose_frames: frames of each docking approach.
    """

    seed: int = 2006
    jobs: int = 2
    trial_frames: int = 300
    passes: int = 9
    timed_frames: int = 90
    spectrum_seconds: float = 60.0
    repeats: int = 10
    runway_frames: int = 240
    identity_scenes: int = len(SCENES)
    identity_repeats: int = 1
    pose_frames: int = 1000

    @classmethod
    def quick(cls, seed: int, jobs: int) -> Plan:
        """Enough to see that everything works, in seconds; the numbers are rough."""
        return cls(
            seed=seed,
            jobs=jobs,
            trial_frames=60,
            passes=3,
            timed_frames=45,
            spectrum_seconds=12.0,
            repeats=3,
            runway_frames=45,
            identity_scenes=2,
            identity_repeats=1,
            pose_frames=200,
        )


@dataclass(frozen=True)
class ExperimentRunner:
    """What a chapter needs to get its flights flown."""

    plan: Plan
    advance: Callable[[], None] = lambda: None

    def all_of(self, work: Callable[[TaskT], ResultT], tasks: Sequence[TaskT]) -> list[ResultT]:
        """The work on every task, in the plan's processes."""
        return all_of(work, tasks, self.plan.jobs, self.advance)


def tracker(**values: Value) -> MarkerTrackerParameters:
    """The marker tracker's parameters with the thesis's centroid."""
    given = supported(MarkerTrackerParameters, {'centroid': 'binary'})
    return MarkerTrackerParameters.from_mapping({**given, **values})


def tracking_pipelines() -> dict[str, MarkerTrackerParameters]:
    """The parameters of each of `RUNS`."""
    by_method = {method: tracker(mode='track', prediction=method) for method in METHODS}
    return {**by_method, SHIPPED: MarkerTrackerParameters()}


def detector() -> RunwayDetectorParameters:
    """The runway detector's parameters for the thesis's scheme."""
    given = supported(RunwayDetectorParameters, {'mode': 'thesis'})
    return RunwayDetectorParameters.from_mapping(given)


def words(name: str) -> str:
    """A parameter's choice as people write it."""
    return name.replace('_', ' ')

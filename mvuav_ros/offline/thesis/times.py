"""Figures 5.1 to 5.3: time per frame by method, at the start, and while lights are out."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mvuav_ros.offline.evaluation.numbers import Array
from mvuav_ros.offline.evaluation.stopwatch import least_ms
from mvuav_ros.offline.report.model import (
    NOT_AVAILABLE,
    Cell,
    Claim,
    Column,
    Section,
    Table,
)
from mvuav_ros.offline.thesis import known
from mvuav_ros.offline.thesis.plan import (
    SHIPPED,
    ExperimentRunner,
    Plan,
    tracker,
    tracking_pipelines,
    words,
)
from mvuav_ros.offline.thesis.stages import table_5_2, table_5_7, timed_images
from mvuav_ros.offline.thesis.times_figures import (
    Loss,
    loss_figure,
    method_figure,
    transient_figure,
)
from mvuav_ros.parameters.marker_tracker import (
    MODES,
    MarkerTrackerParameters,
)
from mvuav_ros.simulation.settings import TankerSettings
from mvuav_ros.simulation.tanker import TankerFlight
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.results import MarkerResult, MarkerState, Window
from mvuav_ros.vision.markers.thesis_tracker import WHOLE_FRAMES
from mvuav_ros.vision.markers.tracker import MarkerTracker

Frames = Sequence[tuple[Image, int]]
_TRACK = 'track'
_FAILURES = 'right_wing@0.6-1.0, rudder@0.8-1.0, all@1.6-1.8'


@dataclass(frozen=True)
class Timed:
    """A pipeline over a flight: ms of each frame, and the results."""

    ms: Array
    results: tuple[MarkerResult, ...]

    @property
    def median(self) -> float:
        """Ms, without the start."""
        return float(np.median(self.ms[WHOLE_FRAMES:]))


def times_section(workshop: ExperimentRunner) -> tuple[Section, list[Claim]]:
    """Time the marker programs and the runway scheme; nothing else may run meanwhile."""
    plan = workshop.plan
    frames = timed_images(plan)
    timed = {name: time_pipeline(p, frames, plan.passes) for name, p in methods().items()}
    workshop.advance()
    share = window_share(timed, frames)
    section = Section(
        'Time per frame',
        (
            'Each time is the least of several passes over the same frames, so that other work '
            "on the machine does not count. The thesis's times are of MATLAB programs on its "
            'machine; the ratio between a whole and a tracked frame compares better than the '
            'times themselves.',
        ),
        (
            table_5_2(frames, plan.passes),
            table_5_7(plan),
            _methods_table(timed, share),
            method_figure({name: t.ms for name, t in timed.items()}),
            transient_figure({n: t.ms for n, t in timed.items() if n.startswith(f'{_TRACK},')}),
            loss_figure(*_loss(plan)),
        ),
    )
    workshop.advance()
    return section, _claims(timed, share)


def methods() -> dict[str, MarkerTrackerParameters]:
    """Every mode, and tracking by every method of prediction."""
    given = {mode: tracker(mode=mode) for mode in MODES if mode != _TRACK}
    given |= {
        f'{_TRACK}, {words(name)}': parameters for name, parameters in tracking_pipelines().items()
    }
    return given


def time_pipeline(parameters: MarkerTrackerParameters, frames: Frames, passes: int) -> Timed:
    """Run a pipeline over the frames several times, afresh each time."""
    seconds: list[list[float]] = []
    results: list[MarkerResult] = []
    for _ in range(passes):
        pipeline = MarkerTracker(parameters)
        results, taken = [], []
        for image, stamp_ns in frames:
            start = time.perf_counter()
            results.append(pipeline.process(image, stamp_ns))
            taken.append(time.perf_counter() - start)
        seconds.append(taken)
    return Timed(least_ms(seconds), tuple(results))


def window_share(timed: Mapping[str, Timed], frames: Frames) -> float:
    """The search windows' part of the frame, as the thesis's tracking has them."""
    image = frames[-1][0]
    windows = timed[f'{_TRACK}, velocity'].results[-1].windows
    return sum(map(_area, windows)) / (image.width * image.height)


def _area(window: Window) -> int:
    return (window.x1 - window.x0 + 1) * (window.y1 - window.y0 + 1)


def _methods_table(timed: Mapping[str, Timed], share: float) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for name, run in timed.items():
        steady = run.ms[WHOLE_FRAMES:]
        thesis = NOT_AVAILABLE
        if name == 'detect':
            thesis = f'{known.FULL_FRAME_MS:g} ms'
        elif name in (f'{_TRACK}, velocity', f'{_TRACK}, acceleration'):
            thesis = f'{known.TRACKED_MS:g} ms'
        ratio = timed['detect'].median / run.median
        rows.append((name, run.median, float(np.percentile(steady, 95)), ratio, thesis))
    return Table(
        'times_by_method',
        'Numbers of Figure 5.1: time per frame by method',
        (
            Column('mode, prediction'),
            Column('median', 'ms', 4),
            Column('95 %', 'ms', 4),
            Column('faster than detect', 'times', 1),
            Column('thesis'),
        ),
        tuple(rows),
        (
            f"Without the first {WHOLE_FRAMES} frames. The thesis's 85 and 30 ms are "
            f'{known.FULL_FRAME_MS / known.TRACKED_MS:.1f} to 1. Search windows: '
            f'{100 * share:.2f} % of the frame here, {100 * known.WINDOW_SHARE:.2f} % by the '
            f"thesis's program, {100 * known.WINDOW_SHARE_ABSTRACT:.2f} % by its abstract.",
        ),
    )


def _loss(plan: Plan) -> tuple[dict[str, Array], Loss]:
    """The loss variant: some lights go out and come back, then all of them."""
    flight = TankerFlight(
        TankerSettings(motion='roll_translation', frames=75, seed=plan.seed, failures=_FAILURES)
    )
    drawn = list(flight)
    frames = [(frame.image, frame.stamp_ns) for frame in drawn]
    chosen = {name: p for name, p in methods().items() if _belongs_to_loss(name)}
    timed = {name: time_pipeline(p, frames, plan.passes) for name, p in chosen.items()}
    lit = [sum(marker.visible for marker in frame.truth.markers) for frame in drawn]
    found = {
        name: np.array(
            [sum(m.state is MarkerState.DETECTED for m in r.markers) for r in run.results]
        )
        for name, run in timed.items()
    }
    seconds = np.array([flight.time(index) for index in flight.indices])
    return {name: run.ms for name, run in timed.items()}, Loss(seconds, np.array(lit), found)


def _belongs_to_loss(name: str) -> bool:
    return name in ('detect', 'detect_any', f'{_TRACK}, velocity', f'{_TRACK}, {SHIPPED}')


def _claims(timed: Mapping[str, Timed], share: float) -> list[Claim]:
    whole = timed['detect'].median
    tracked = max(timed[f'{_TRACK}, {m}'].median for m in ('velocity', 'acceleration'))
    return [
        Claim(
            'Time of a whole frame',
            f'{known.FULL_FRAME_MS:g} ms',
            f'{whole:.3f} ms',
            whole < known.FULL_FRAME_MS,
        ),
        Claim(
            'Time of a tracked frame',
            f'{known.TRACKED_MS:g} ms',
            f'{tracked:.3f} ms',
            tracked < known.TRACKED_MS,
        ),
        Claim(
            'Search windows, part of the frame',
            f'{100 * known.WINDOW_SHARE:.2f} % (program), '
            f'{100 * known.WINDOW_SHARE_ABSTRACT:.2f} % (abstract)',
            f'{100 * share:.2f} %',
            round(share, 4) == known.WINDOW_SHARE,
        ),
    ]

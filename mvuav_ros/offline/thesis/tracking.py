"""Table 5.3 and Figures 5.4 to 5.9: prediction and position in the four trials."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mvuav_ros.offline.evaluation.marker_runs import FlownMarkers, MarkerTask, fly_markers
from mvuav_ros.offline.evaluation.numbers import distance_rms, rms
from mvuav_ros.offline.report.model import NOT_AVAILABLE, Cell, Claim, Column, Section, Table
from mvuav_ros.offline.thesis import known
from mvuav_ros.offline.thesis.plan import (
    RUNS,
    SHIPPED,
    THESIS_RUN,
    TRIAL_FPS,
    ExperimentRunner,
    Plan,
    tracking_pipelines,
    words,
)
from mvuav_ros.offline.thesis.tracking_figures import MARKER_NAMES, tracking_figures
from mvuav_ros.simulation.settings import TRIALS, TankerSettings
from mvuav_ros.simulation.shake import VIBRATIONS

THESIS_METHODS = ('velocity', 'acceleration')
"""The thesis's two predictors, as its equations have them."""
_BELOW = f'< {known.PREDICTION_RMS_PX:g} (conclusion)'
_COLUMNS = tuple(Column(words(name), 'px') for name in RUNS)
_ABOUT_METHODS = (
    '"none" keeps the last position; "acceleration" is eqs 3.16 and 4.2 as printed, "acceleration '
    'program" what the code of Appendix C computes (opposite sign, half the size). All with the '
    'binary centroid; "as shipped" is the node with its default parameters.'
)


def tracking_tasks(plan: Plan) -> list[MarkerTask]:
    """The four trials without vibration, then with vibrations 1 to 3."""
    return [
        MarkerTask(trial_settings(plan, trial, shake), tracking_pipelines())
        for shake in range(len(VIBRATIONS))
        for trial in TRIALS
    ]


def trial_settings(plan: Plan, trial: str, shake: int = 0) -> TankerSettings:
    """A trial's flight."""
    return TankerSettings(
        motion=trial, fps=TRIAL_FPS, frames=plan.trial_frames, seed=plan.seed, shake=shake
    )


def tracking_section(workshop: ExperimentRunner) -> tuple[Section, list[Claim]]:
    """Fly the trials and say how well they were predicted and measured."""
    flown = workshop.all_of(fly_markers, tracking_tasks(workshop.plan))
    steady = [flight for flight in flown if flight.settings.shake == 0]
    section = Section(
        'Prediction and position',
        (
            'Four trials with a simulated tanker in the lab view (640x480, field of view 60°): '
            'translation, erratic motion as by hand, roll sweep of ±60°, roll with translation; '
            f"{workshop.plan.trial_frames} frames at {TRIAL_FPS:g} frames/s each. The thesis's "
            'recordings are not available to us, so the motion is ours; the frame rate is that of '
            "our reference runs of its programs, half of an ordinary camera's and so the harder "
            'case.',
            'The RMS of prediction is the root mean square distance between where a marker was '
            'predicted and where it was then found: all that the thesis could measure. Truth '
            'adds how far both were from where the light really was.',
        ),
        (
            table_5_3(steady),
            *tracking_figures(steady),
            _vibration_table(flown),
            _found_table(steady),
            _predicted_table(steady),
        ),
    )
    return section, claims_of(steady)


def table_5_3(steady: Sequence[FlownMarkers]) -> Table:
    """RMS of prediction by trial, marker and method."""
    rows: list[tuple[Cell, ...]] = []
    for flight in steady:
        errors = [flight.runs[name].prediction_error for name in RUNS]
        trial = words(flight.settings.motion)
        for index, name in enumerate(MARKER_NAMES):
            values = [distance_rms(error[:, index]) for error in errors]
            rows.append((trial, name, *values, NOT_AVAILABLE))
        rows.append((trial, 'all five', *map(distance_rms, errors), _BELOW))
    return Table(
        'table_5_3',
        'Table 5.3: RMS of prediction by marker, method and trial',
        (Column('trial'), Column('marker'), *_COLUMNS, Column('thesis')),
        tuple(rows),
        (
            _ABOUT_METHODS,
            "The thesis's cells of this table are not available to us; its conclusion is: below "
            '1 px in all trials.',
        ),
    )


def _vibration_table(flown: Sequence[FlownMarkers]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for flight in sorted(flown, key=lambda f: TRIALS.index(f.settings.motion)):
        values = [distance_rms(flight.runs[name].prediction_error) for name in RUNS]
        best = words(RUNS[int(np.nanargmin(values))])
        vibration = str(flight.settings.shake or 'none')
        rows.append((words(flight.settings.motion), vibration, *values, best))
    return Table(
        'table_5_3_vibration',
        'Table 5.3, continued: the same with camera vibration',
        (Column('trial'), Column('vibration'), *_COLUMNS, Column('best')),
        tuple(rows),
        (
            'All five markers pooled; vibrations 1 to 3 are those of Table 5.4 below. Of the '
            "thesis's methods an extrapolator does best on a steady camera and a smoother on a "
            'shaking one, which may be why the thesis saw no clear winner.',
        ),
    )


def _found_table(steady: Sequence[FlownMarkers]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for flight in steady:
        for name, program in ((THESIS_RUN, "the thesis's programs"), (SHIPPED, SHIPPED)):
            error = flight.found_error(name)
            rows.append(
                (
                    words(flight.settings.motion),
                    program,
                    rms(error[..., 0]),
                    rms(error[..., 1]),
                    distance_rms(error),
                    math.degrees(rms(flight.roll_error(name))),
                )
            )
    return Table(
        'table_5_3_truth_found',
        'What truth adds: RMS error of what was found',
        (
            Column('trial'),
            Column('by'),
            Column('x', 'px'),
            Column('y', 'px'),
            Column('distance', 'px'),
            Column('roll', '°', 4),
        ),
        tuple(rows),
        (
            'Found places minus the projected centres of the lights, five markers pooled. The '
            'thesis had no truth, so there is no number of its own. On our reference videos its '
            'programs, run in Octave, are off by 0.084 to 0.087 px per axis and 0.017° of roll.',
        ),
    )


def _predicted_table(steady: Sequence[FlownMarkers]) -> Table:
    rows: tuple[tuple[Cell, ...], ...] = tuple(
        (
            words(flight.settings.motion),
            *(distance_rms(flight.predicted_error(name)) for name in RUNS),
        )
        for flight in steady
    )
    return Table(
        'table_5_3_truth_predicted',
        'What truth adds to Table 5.3: RMS error of the predictions',
        (Column('trial'), *_COLUMNS),
        rows,
        (
            'Predicted places minus the projected centres of the lights, five markers pooled. '
            'Smaller than in Table 5.3, where the error of what was found counts as well.',
        ),
    )


def claims_of(steady: Sequence[FlownMarkers]) -> list[Claim]:
    """The thesis's conclusion on prediction, for both of its methods."""
    return [_claim(steady, method) for method in THESIS_METHODS]


def _claim(steady: Sequence[FlownMarkers], method: str) -> Claim:
    pooled = {f.settings.motion: distance_rms(f.runs[method].prediction_error) for f in steady}
    worst = max(pooled, key=lambda trial: pooled[trial])
    return Claim(
        f'RMS of prediction in all four trials, {method}',
        f'below {known.PREDICTION_RMS_PX:g} px (its conclusion)',
        f'at most {pooled[worst]:.3f} px ({words(worst)})',
        all(value < known.PREDICTION_RMS_PX for value in pooled.values()),
    )

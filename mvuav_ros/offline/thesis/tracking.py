"""Table 5.3 and Figures 5.4 to 5.9: prediction and position in the four trials."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mvuav_ros.offline.evaluation.marker_runs import FlownMarkers
from mvuav_ros.offline.evaluation.numbers import Array, distance_rms, rms
from mvuav_ros.offline.report.comparison import SHIPPED, Compared
from mvuav_ros.offline.report.model import Cell, Claim, Column, Section, Table
from mvuav_ros.offline.thesis import known
from mvuav_ros.offline.thesis.plan import PROGRAM, PROGRAM_OF, RUNS, Plan, words
from mvuav_ros.offline.thesis.statements import (
    beats_text,
    bound_text,
    inside_text,
    ratio_text,
    smaller_text,
    thesis_winners_text,
    winners_text,
)
from mvuav_ros.offline.thesis.tracking_figures import tracking_figures
from mvuav_ros.offline.thesis.trials import Trial, lengths, trials_of

_RUN_COLUMNS = tuple(Column(words(name), 'px') for name in RUNS)
_MARKER_COLUMNS = tuple(Column(name, 'px') for name in known.MARKERS)


def tracking_section(plan: Plan, flown: Sequence[FlownMarkers]) -> tuple[Section, list[Claim]]:
    """Say how well the trials were predicted and measured."""
    trials, shaken = trials_of(flown)
    section = Section(
        'Prediction and position',
        (
            f'Four trials of {plan.trial_frames} frames at {known.TRIAL_FPS:g} frames/s with a '
            'simulated tanker in the lab view (640x480, field of view 60°), each flown '
            f'{plan.trial_repeats} times with seeds of its own. The thesis gives the trials '
            'their names and no paths; the paths here are those of the simulator.',
            'The RMS of prediction is the root mean square distance between where a marker was '
            'predicted and where it was then found: all that the thesis could measure. Truth '
            'adds how far both were from where the light really was.',
        ),
        (
            table_5_1(plan.trial_frames),
            table_5_3(trials),
            ratio_table(trials),
            *tracking_figures(trials),
            vibration_table(trials, shaken),
            found_table(trials),
            predicted_table(trials),
        ),
    )
    return section, claims_of(trials)


def table_5_1(frames: int) -> Table:
    """Which trials are compared for what; the thesis's table has no numbers."""
    flown = f'trials 1 to 4, {frames} frames'
    return Table(
        'table_5_1',
        'Table 5.1: the trials used for evaluation',
        (Column('comparison'), Column('thesis'), Column('here')),
        (
            ('frame time (Figure 5.1)', 'trials 1 to 4', flown),
            ('profiler (Table 5.2)', 'trial 1', f'trial 1, {frames} frames'),
            ('RMS position error (Table 5.3)', 'trials 1 to 4', flown),
            ('roll angle (Figure 5.8)', 'trials 1 to 4', flown),
            (
                'vibration (Table 5.5)',
                'roll 0, 20, 50°, four conditions',
                'roll 0, 20, 50°, four conditions',
            ),
        ),
    )


def table_5_3(trials: Sequence[Trial]) -> Table:
    """RMS of prediction by trial, method and marker, each row under the thesis's own."""
    rows: list[tuple[Cell, ...]] = []
    for trial in trials:
        printed = {kind: _printed(trial, kind) for kind in known.ESTIMATIONS}
        for kind, cells in printed.items():
            rows.append((trial.title, kind, 'thesis', *(cell.text for cell in cells)))
            here = [
                Compared.of(trial.error(PROGRAM_OF[kind], marker), cell.value)
                for marker, cell in enumerate(cells)
            ]
            rows.append((trial.title, kind, 'here', *here))
        printed_equations = [trial.error('acceleration', i).value for i in range(len(_MARKERS))]
        rows.append((trial.title, 'equations as printed', 'here', *printed_equations))
        best = [min(c.value for c in cells) for cells in zip(*printed.values(), strict=True)]
        shipped = [
            Compared.of(trial.error(SHIPPED, marker), value, SHIPPED)
            for marker, value in enumerate(best)
        ]
        rows.append((trial.title, SHIPPED, 'here', *shipped))
    return Table(
        'table_5_3',
        'Table 5.3: RMS of prediction by marker, method and trial',
        (Column('trial'), Column('estimation'), Column('by'), *_MARKER_COLUMNS),
        tuple(rows),
        (
            'Full estimation is the program of Appendix C, whose acceleration has the opposite '
            'sign and half the size of eq. 3.16; "equations as printed" are eqs 3.16 and 4.2. All '
            'with the binary centroid. "As shipped" is the node with its defaults, held against '
            'the better of the two cells of the thesis. In brackets: 95 % confidence from the '
            'scatter between flights.',
            thesis_winners_text(),
            winners_text(trials),
        ),
    )


_MARKERS = known.MARKERS


def _printed(trial: Trial, kind: str) -> list[known.Known]:
    row = f'Trial {trial.number}, {kind}'
    return [known.cell('table_5_3', row, marker) for marker in known.MARKERS]


def ratio_table(trials: Sequence[Trial]) -> Table:
    """Full estimation over velocity only: the methods without the speed of the motion."""
    rows: list[tuple[Cell, ...]] = []
    printed, measured = [], []
    bounds, accelerations = [], []
    for trial in trials:
        full, velocity = (
            np.array([cell.value for cell in _printed(trial, kind)])
            for kind in (known.FULL, known.VELOCITY)
        )
        ours = [
            trial.error(PROGRAM, i).value / trial.error('velocity', i).value
            for i in range(len(_MARKERS))
        ]
        printed.append([float(ratio) for ratio in full / velocity])
        measured.append(ours)
        rows.append((trial.title, 'thesis', *printed[-1]))
        rows.append((trial.title, 'here', *ours))
        bounds.append([float(value) for value in velocity])
        accelerations.append([float(value) for value in _accelerations(trial)])
        rows.append((trial.title, 'acceleration [px/frame²]', *accelerations[-1]))
    return Table(
        'table_5_3_ratio',
        'Table 5.3: full estimation over velocity only',
        (Column('trial'), Column('by'), *(Column(name, '', 2) for name in _MARKERS)),
        tuple(rows),
        (
            'Both methods go wrong by the acceleration of a marker, so that a trial with twice '
            'the acceleration doubles every cell of Table 5.3. Their ratio is free of it: an '
            'acceleration that stays gives 1.25, noise alone 0.85. The acceleration is that of '
            'the true places, RMS.',
            ratio_text(printed, measured),
            bound_text(bounds, accelerations),
        ),
    )


def _accelerations(trial: Trial) -> Array:
    """RMS second difference of the true places by marker, px per frame squared."""
    second = np.concatenate([np.diff(flight.places, 2, axis=0) for flight in trial.flights])
    return np.asarray([distance_rms(second[:, marker]) for marker in range(second.shape[1])])


def vibration_table(trials: Sequence[Trial], shaken: Sequence[FlownMarkers]) -> Table:
    """The errors of prediction before a shaking camera."""
    rows: list[tuple[Cell, ...]] = []
    for trial in trials:
        same = [f for f in shaken if words(f.settings.motion) == trial.motion]
        for flight in (trial.first, *same):
            values = [distance_rms(flight.runs[name].prediction_error) for name in RUNS]
            best = words(RUNS[int(np.nanargmin(values))])
            rows.append((trial.title, known.CONDITIONS[flight.settings.shake], *values, best))
    return Table(
        'table_5_3_vibration',
        'What vibration does to Table 5.3',
        (Column('trial'), Column('condition'), *_RUN_COLUMNS, Column('best')),
        tuple(rows),
        (
            'All five markers of one flight pooled; the vibrations are those of Table 5.4. The '
            'thesis predicted on steady videos only.',
            beats_text([row for row in rows if row[1] != known.CONDITIONS[0]], RUNS),
        ),
    )


def found_table(trials: Sequence[Trial]) -> Table:
    """How far found places are from the truth."""
    rows: list[tuple[Cell, ...]] = []
    for trial in trials:
        for name, program in ((PROGRAM, "the thesis's program"), (SHIPPED, SHIPPED)):
            error = np.concatenate([flight.found_error(name) for flight in trial.flights])
            roll = np.concatenate([flight.roll_error(name) for flight in trial.flights])
            x, y = rms(error[..., 0]), rms(error[..., 1])
            rows.append((trial.title, program, x, y, distance_rms(error), math.degrees(rms(roll))))
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
            'thesis had no truth, so there is no number of its own.',
        ),
    )


def predicted_table(trials: Sequence[Trial]) -> Table:
    """How far predicted places are from the truth."""
    rows: list[tuple[Cell, ...]] = []
    against_found = []
    for trial in trials:
        true = [
            distance_rms(np.concatenate([f.predicted_error(name) for f in trial.flights]))
            for name in RUNS
        ]
        rows.append((trial.title, *true))
        against_found.append([trial.pooled(name) for name in RUNS])
    return Table(
        'table_5_3_truth_predicted',
        'What truth adds to Table 5.3: RMS error of the predictions',
        (Column('trial'), *_RUN_COLUMNS),
        tuple(rows),
        (
            'Predicted places minus the projected centres of the lights, five markers pooled.',
            smaller_text([list(map(_number, row[1:])) for row in rows], against_found),
        ),
    )


def _number(cell: Cell) -> float:
    return float(cell) if isinstance(cell, float | int) else math.nan


def claims_of(trials: Sequence[Trial]) -> list[Claim]:
    """What the thesis says of Table 5.3 and Figure 5.7, for the methods that it measured."""
    claims = [_below_one_pixel(trials, kind) for kind in known.ESTIMATIONS]
    distances = np.concatenate([lengths(f, PROGRAM).ravel() for t in trials for f in t.flights])
    seen = distances[np.isfinite(distances)]
    inside = float(np.mean(seen < known.ERROR_PX))
    claims.append(
        Claim(
            f'Error of prediction below {known.ERROR_PX:g} px in almost every instance, program',
            'almost every (Figure 5.7)',
            inside_text(int(np.sum(seen < known.ERROR_PX)), len(seen)),
            inside > 0.99,
        )
    )
    erratic = next((trial for trial in trials if trial.number == 2), None)
    if erratic is not None:
        wins = sum(
            erratic.error('velocity', i).value < erratic.error(PROGRAM, i).value
            for i in range(len(_MARKERS))
        )
        claims.append(
            Claim(
                'In trial 2 velocity only is the clear winner over full estimation',
                '5 of 5 markers',
                f'{wins} of 5 markers',
                wins == len(_MARKERS),
            )
        )
    return claims


def _below_one_pixel(trials: Sequence[Trial], kind: str) -> Claim:
    values = {
        f'{trial.motion}, {name.lower()}': trial.error(PROGRAM_OF[kind], i).value
        for trial in trials
        for i, name in enumerate(_MARKERS)
    }
    above = sum(value >= known.PREDICTION_RMS_PX for value in values.values())
    worst = max(values, key=lambda place: values[place])
    method = 'eq. 4.1' if kind == known.VELOCITY else 'program of Appendix C'
    return Claim(
        f'No cell of Table 5.3 above {known.PREDICTION_RMS_PX:g} px: {kind.lower()} ({method})',
        f'0 of {len(values)} above',
        f'{above} of {len(values)} above; the worst {values[worst]:.3f} px ({worst})',
        above == 0,
    )

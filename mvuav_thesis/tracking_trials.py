"""Table 5.3 and Figures 5.4 to 5.9: prediction and position in the four trials."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from mvuav_ros.offline.evaluation.metrics import Array, distance_rms, rms
from mvuav_ros.offline.report import Cell, Section, Table
from mvuav_thesis import known
from mvuav_thesis.comparison import METHOD, SHIPPED, Claim, Compared
from mvuav_thesis.plan import PROGRAM, PROGRAM_OF, RUNS, Plan, words
from mvuav_thesis.tracking_figures import inside_text, tracking_figures
from mvuav_thesis.trials import FlownMarkers, Trial, lengths, trials_of

_RUN_COLUMNS = ' | '.join(f'{words(name)} [px]' for name in RUNS)
_MARKERS = known.MARKERS


def tracking_section(plan: Plan, flown: Sequence[FlownMarkers]) -> tuple[Section, list[Claim]]:
    """Say how well the trials were predicted and measured."""
    trials, shaken = trials_of(flown)
    section = Section(
        'Prediction and position',
        (
            f'Four trials of {plan.trial_frames} frames at {known.TRIAL_FPS:g} frames/s with a '
            'simulated tanker in the lab view (640x480, field of view 60°), each flown '
            f'{plan.trial_repeats} times with seeds of its own. The thesis numbers its trials, and '
            'says of their motion that the second is erratic and that the tanker turns back in the '
            'first; names and paths here are those of the simulator.',
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
    rolls = 'roll 0, 20, 50°, four conditions'
    return Table.of(
        'table_5_1',
        'Table 5.1: the trials used for evaluation',
        'comparison | thesis | here',
        (
            ('frame time (Figure 5.1)', 'trials 1 to 4', flown),
            ('profiler (Table 5.2)', 'trials 1 to 4, numbers of 1', f'trial 1, {frames} frames'),
            ('RMS position error (Table 5.3)', 'trials 1 to 4', flown),
            ('roll angle (Figure 5.8)', 'trials 1 to 4', flown),
            ('vibration (Table 5.5)', rolls, rolls),
        ),
    )


def table_5_3(trials: Sequence[Trial]) -> Table:
    """RMS of prediction by trial, method and marker, each row under the thesis's own."""
    rows: list[tuple[Cell, ...]] = []
    for trial in trials:
        for kind in known.ESTIMATIONS:
            texts = (cell.text for cell in _printed(trial, kind))
            rows.append((trial.title, kind, 'thesis', *texts))
            ours = _beside(trial, PROGRAM_OF[kind], _thesis(trial, kind))
            rows.append((trial.title, kind, 'here', *ours))
        equations = trial.rms('acceleration').tolist()
        rows.append((trial.title, 'equations as printed', 'here', *equations))
        best = np.min([_thesis(trial, kind) for kind in known.ESTIMATIONS], axis=0)
        rows.append((trial.title, SHIPPED, 'here', *_beside(trial, SHIPPED, best, SHIPPED)))
    wins = (f'{_wins(trial)} of {len(_MARKERS)} in trial {trial.number}' for trial in trials)
    return Table.of(
        'table_5_3',
        'Table 5.3: RMS of prediction by marker, method and trial',
        ' | '.join(['trial', 'estimation', 'by', *(f'{name} [px]' for name in _MARKERS)]),
        rows,
        'Full estimation is the program of Appendix C, whose acceleration has the opposite '
        'sign and half the size of eq. 3.16; "equations as printed" are eqs 3.16 and 4.2. All '
        'with the binary centroid. "As shipped" is the node with its defaults, held against '
        'the better of the two cells of the thesis. In brackets: 95 % confidence from the '
        'scatter between flights.',
        _thesis_winners(trials),
        f'Here velocity only is smaller than full estimation for {", ".join(wins)}.',
    )


def _printed(trial: Trial, kind: str) -> list[known.Known]:
    row = f'Trial {trial.number}, {kind}'
    return [known.cell('table_5_3', row, marker) for marker in _MARKERS]


def _thesis(trial: Trial, kind: str) -> Array:
    """The thesis's RMS of prediction by marker, px."""
    return np.array([cell.value for cell in _printed(trial, kind)])


def _beside(trial: Trial, method: str, published: Array, by: str = METHOD) -> list[Compared]:
    pairs = zip(trial.errors(method), published.tolist(), strict=True)
    return [Compared.of(error, value, by) for error, value in pairs]


def _wins(trial: Trial) -> int:
    """For how many markers velocity only is better than full estimation."""
    return int(np.sum(trial.rms('velocity') < trial.rms(PROGRAM)))


def _thesis_winners(trials: Sequence[Trial]) -> str:
    """How often each of the thesis's methods is the smaller in its own Table 5.3."""
    velocity, full = (
        np.array([_thesis(trial, kind) for trial in trials]) for kind in known.ESTIMATIONS
    )
    return (
        'The thesis sees no clear winner, each method ahead in roughly half of the cells. In its '
        f'own numbers velocity only is smaller in {np.sum(velocity < full)} of {full.size} cells, '
        f'full estimation in {np.sum(full < velocity)}, {np.sum(full == velocity)} equal.'
    )


def ratio_table(trials: Sequence[Trial]) -> Table:
    """Full estimation over velocity only: the methods without the speed of the motion."""
    rows: list[tuple[Cell, ...]] = []
    smaller = larger = 0
    faster = []
    for trial in trials:
        velocity = _thesis(trial, known.VELOCITY)
        printed = _thesis(trial, known.FULL) / velocity
        ours = trial.rms(PROGRAM) / trial.rms('velocity')
        accelerations = _accelerations(trial)
        rows.append((trial.title, 'thesis', *printed.tolist()))
        rows.append((trial.title, 'here', *ours.tolist()))
        rows.append((trial.title, 'acceleration [px/frame²]', *accelerations.tolist()))
        smaller += int(np.sum(ours < printed))
        larger += int(np.sum(ours > printed))
        count = np.sum(accelerations > velocity)
        faster.append(f'{count} of {len(_MARKERS)} in trial {trial.number}')
    return Table.of(
        'table_5_3_ratio',
        'Table 5.3: full estimation over velocity only',
        ' | '.join(['trial', 'by', *(f'{name} .2' for name in _MARKERS)]),
        rows,
        'Both methods go wrong by the acceleration of a marker, so that a trial with twice '
        'the acceleration doubles every cell of Table 5.3. Their ratio is free of it: an '
        'acceleration that stays gives 1.25, noise alone 0.85. The acceleration is that of '
        'the true places, RMS.',
        f'The ratio is smaller here than in the thesis in {smaller} of '
        f'{len(trials) * len(_MARKERS)} cells, larger in {larger}.',
        'Velocity only goes wrong by at least the acceleration, so that each of its cells in the '
        'thesis is the most that the acceleration of that marker can have been there. Here it is '
        f'more than that for {", ".join(faster)}: there a worse cell is the motion, and no method '
        'of the thesis could be equal.',
    )


def _accelerations(trial: Trial) -> Array:
    """RMS second difference of the true places by marker, px per frame squared."""
    second = np.concatenate([np.diff(flight.places, 2, axis=0) for flight in trial.flights])
    return np.array([distance_rms(second[:, marker]) for marker in range(second.shape[1])])


def vibration_table(trials: Sequence[Trial], shaken: Sequence[FlownMarkers]) -> Table:
    """The errors of prediction before a shaking camera."""
    rows: list[tuple[Cell, ...]] = []
    smooth = 0
    best = Counter({words(name): 0 for name in RUNS})
    for trial in trials:
        same = [f for f in shaken if words(f.settings.motion) == trial.motion]
        for flight in (trial.first, *same):
            values = {name: distance_rms(flight.runs[name].prediction_error) for name in RUNS}
            winner = words(RUNS[int(np.nanargmin(list(values.values())))])
            condition = known.CONDITIONS[flight.settings.shake]
            rows.append((trial.title, condition, *values.values(), winner))
            if flight is not trial.first:
                best[winner] += 1
                smooth += values[PROGRAM] < min(values['velocity'], values['acceleration'])
    said = [f'{name} on {number}' for name, number in best.items() if number]
    return Table.of(
        'table_5_3_vibration',
        'What vibration does to Table 5.3',
        f'trial | condition | {_RUN_COLUMNS} | best',
        rows,
        'All five markers of one flight pooled; the vibrations are those of Table 5.4. The '
        'thesis predicted on steady videos only.',
        f'Best of the {best.total()} shaken flights: {", ".join(said)}. The program of Appendix C, '
        f'which smooths, beats both extrapolators (velocity and the equations) on {smooth} of '
        f'{best.total()}.',
    )


def found_table(trials: Sequence[Trial]) -> Table:
    """How far found places are from the truth."""
    rows = []
    for trial in trials:
        for name, program in ((PROGRAM, "the thesis's program"), (SHIPPED, SHIPPED)):
            error = np.concatenate([flight.found_error(name) for flight in trial.flights])
            roll = np.concatenate([flight.roll_error(name) for flight in trial.flights])
            x, y = rms(error[..., 0]), rms(error[..., 1])
            rows.append((trial.title, program, x, y, distance_rms(error), math.degrees(rms(roll))))
    return Table.of(
        'table_5_3_truth_found',
        'What truth adds: RMS error of what was found',
        'trial | by | x [px] | y [px] | distance [px] | roll [°] .4',
        rows,
        'Found places minus the projected centres of the lights, five markers pooled. The '
        'thesis had no truth, so there is no number of its own.',
    )


def predicted_table(trials: Sequence[Trial]) -> Table:
    """How far predicted places are from the truth."""
    rows: list[tuple[Cell, ...]] = []
    smaller = 0
    for trial in trials:
        errors = [
            distance_rms(np.concatenate([f.predicted_error(name) for f in trial.flights]))
            for name in RUNS
        ]
        rows.append((trial.title, *errors))
        smaller += sum(e < trial.pooled(name) for e, name in zip(errors, RUNS, strict=True))
    return Table.of(
        'table_5_3_truth_predicted',
        'What truth adds to Table 5.3: RMS error of the predictions',
        f'trial | {_RUN_COLUMNS}',
        rows,
        'Predicted places minus the projected centres of the lights, five markers pooled.',
        'Smaller than predicted minus found, which holds the error of what was found as well, in '
        f'{smaller} of {len(rows) * len(RUNS)} cells.',
    )


def claims_of(trials: Sequence[Trial]) -> list[Claim]:
    """What the thesis says of Table 5.3 and Figure 5.7, for the methods that it measured."""
    distances = np.concatenate([lengths(f, PROGRAM).ravel() for t in trials for f in t.flights])
    seen = distances[np.isfinite(distances)]
    claims = [
        *(_below_one_pixel(trials, kind) for kind in known.ESTIMATIONS),
        Claim(
            f'Error of prediction below {known.ERROR_PX:g} px in almost every instance, program',
            'almost every (Figure 5.7)',
            inside_text(seen),
            float(np.mean(seen < known.ERROR_PX)) > 0.99,
        ),
    ]
    for erratic in (trial for trial in trials if trial.number == 2):
        wins = _wins(erratic)
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
        f'{trial.motion}, {name.lower()}': value
        for trial in trials
        for name, value in zip(_MARKERS, trial.rms(PROGRAM_OF[kind]).tolist(), strict=True)
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

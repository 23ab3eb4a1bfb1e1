"""What the report says in words, computed from the numbers that it speaks of."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

from mvuav_ros.offline.report.model import Cell
from mvuav_ros.offline.thesis import known
from mvuav_ros.offline.thesis.plan import PROGRAM, words

if TYPE_CHECKING:
    from mvuav_ros.offline.thesis.trials import Trial


def thesis_winners_text() -> str:
    """How often each of the thesis's methods is the smaller in its own Table 5.3."""
    pairs = [
        tuple(
            known.cell('table_5_3', f'Trial {trial}, {kind}', marker).value
            for kind in known.ESTIMATIONS
        )
        for trial in range(1, 5)
        for marker in known.MARKERS
    ]
    velocity = sum(v < f for v, f in pairs)
    full = sum(f < v for v, f in pairs)
    return (
        'The thesis sees no clear winner, each method ahead in roughly half of the cells. In its '
        f'own numbers velocity only is smaller in {velocity} of {len(pairs)} cells, full '
        f'estimation in {full}, {len(pairs) - velocity - full} equal.'
    )


def winners_text(trials: Sequence[Trial]) -> str:
    """The same in ours."""
    parts = []
    for trial in trials:
        wins = sum(
            trial.error('velocity', i).value < trial.error(PROGRAM, i).value
            for i in range(len(known.MARKERS))
        )
        parts.append(f'{wins} of {len(known.MARKERS)} in trial {trial.number}')
    return f'Here velocity only is smaller than full estimation for {", ".join(parts)}.'


def ratio_text(thesis: Sequence[Sequence[float]], ours: Sequence[Sequence[float]]) -> str:
    """Where full estimation over velocity only is smaller here than in the thesis."""
    pairs = [pair for a, b in zip(thesis, ours, strict=True) for pair in zip(a, b, strict=True)]
    smaller = sum(o < t for t, o in pairs)
    larger = sum(o > t for t, o in pairs)
    return (
        f'The ratio is smaller here than in the thesis in {smaller} of {len(pairs)} cells, larger '
        f'in {larger}.'
    )


def bound_text(
    velocity: Sequence[Sequence[float]], accelerations: Sequence[Sequence[float]]
) -> str:
    """For how many markers of each trial the motion is faster than that of the thesis can be.

    Args:
        velocity: the thesis's RMS of prediction by velocity only, by trial and marker, px.
        accelerations: of our motion, RMS, px per frame squared.
    """
    above = [
        f'{sum(a > v for v, a in zip(printed, ours, strict=True))} of {len(ours)} in trial {trial}'
        for trial, (printed, ours) in enumerate(zip(velocity, accelerations, strict=True), 1)
    ]
    return (
        'Velocity only goes wrong by at least the acceleration, so that each of its cells in the '
        'thesis is the most that the acceleration of that marker can have been there. Here it is '
        f'more than that for {", ".join(above)}: there a worse cell is the motion, and no method '
        'of the thesis could be equal.'
    )


def beats_text(rows: Sequence[tuple[Cell, ...]], runs: Sequence[str]) -> str:
    """Which method is best on how many flights; the last cell of a row names its best."""
    count = {words(name): sum(row[-1] == words(name) for row in rows) for name in runs}
    said = [f'{name} on {number}' for name, number in count.items() if number]
    extrapolators, smoother = ('velocity', 'acceleration'), PROGRAM
    index = {name: 2 + number for number, name in enumerate(runs)}
    smooth = sum(
        all(_as_float(row[index[smoother]]) < _as_float(row[index[e]]) for e in extrapolators)
        for row in rows
    )
    return (
        f'Best of the {len(rows)} shaken flights: {", ".join(said)}. The program of Appendix C, '
        f'which smooths, beats both extrapolators (velocity and the equations) on {smooth} of '
        f'{len(rows)}.'
    )


def smaller_text(true: Sequence[Sequence[float]], found: Sequence[Sequence[float]]) -> str:
    """In how many cells the error against truth is smaller than the one against what was found."""
    pairs = [pair for a, b in zip(true, found, strict=True) for pair in zip(a, b, strict=True)]
    smaller = sum(a < b for a, b in pairs)
    return (
        f'Smaller than predicted minus found, which holds the error of what was found as well, in '
        f'{smaller} of {len(pairs)} cells.'
    )


def inside_text(inside: int, count: int) -> str:
    """A share with its counts."""
    return f'{100 * inside / count:.2f} % ({inside} of {count})' if count else 'none'


def growth_text(errors: Sequence[tuple[float, float]], name: str) -> str:
    """How an error against truth grows from no vibration to vibration 1, by roll."""
    factors = [b / a for a, b in errors if a > 0]
    return (
        f'From no motion to vibration 1 the error of {name} changes by factors of '
        f'{min(factors):.2f} to {max(factors):.2f}.'
    )


def noise_text(rows: Sequence[tuple[Cell, ...]]) -> str:
    """At which noise each program is below the thesis, which is the last row, by column."""
    *ours, thesis = rows
    printed = [float(str(cell)) for cell in thesis[2:]]
    below = [
        f'{row[1]} at {row[0]} in '
        f'{sum(_as_float(c) < p for c, p in zip(row[2:], printed, strict=True))}'
        for row in ours
    ]
    return f'Below the thesis, of {len(printed)} columns: {", ".join(below)}.'


def monotonic_text(rows: Sequence[Sequence[float]], who: str) -> str:
    """In how many columns values grow from each row to the next."""
    columns = list(zip(*rows, strict=True))
    growing = sum(all(a < b for a, b in pairwise(c)) for c in columns)
    return f'{who}: grows with the vibration in {growing} of {len(columns)} columns.'


def sum_text(total: float, stages: Sequence[float], where: str) -> str:
    """Whether the stages of a printed table add up to its printed total."""
    added = sum(stages)
    if abs(added - total) <= 0.001 * total:
        return f'The stages of {where} in the thesis add up to its total.'
    return (
        f'The stages of {where} in the thesis add up to {added:.4g} s, not to the {total:.5g} s '
        'that it prints as their total.'
    )


def _as_float(cell: Cell) -> float:
    assert isinstance(cell, float | int)
    return float(cell)

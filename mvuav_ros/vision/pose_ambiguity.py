"""Which of several poses that fit a few lights is the right one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.reprojection import MIN_MARKERS, Solution, rotation_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AmbiguityTuning:
    """When one of several solutions is taken.

    Chosen with `mvuav_ros.vision.pose.PoseTuning`; those of three lights on seeds 0 to 29 of
    flights of random rigs.
    """

    alike: float = 4.0  # of two solutions' squared residuals, up to where both fit
    same: float = math.radians(5.0)  # rad, up to which two rotations are one solution
    # Difference of two solutions' squared residuals, over the noise's variance, from which on the
    # less one is right.
    decisive: float = 12.0
    # rad, by which a solution must be nearer to the last pose than the next one.
    nearer: float = math.radians(3.0)
    max_tilt: float = math.radians(45.0)  # rad, from straight behind, of three lights' first pose
    one: float = math.radians(0.5)  # rad, up to which two solutions of three lights are the same
    meeting: float = math.radians(8.0)  # rad, up to which two of them may be taken for each other


TUNING = AmbiguityTuning()


def choose(
    solutions: Sequence[Solution], noise: float, count: int, last: Array | None
) -> Solution | None:
    """The right one of all solutions of a frame, of which one fits at least; None if not clear.

    The noise of a marker's place is in px per axis; the last rotation (3, 3) is a short while old.
    """
    least = min(squares for _, _, squares in solutions)
    limit = TUNING.alike * least + 2 * count * noise**2
    fitting = [solution for solution in solutions if solution[2] <= limit]
    if last is not None:
        return _nearest(last, fitting)
    if count == MIN_MARKERS:
        # As their names do, a pose of three lights presupposes that they are seen from behind.
        fitting = [solution for solution in fitting if _tilt(solution) < TUNING.max_tilt]
        limit, same = math.inf, TUNING.one
    else:
        same = TUNING.same
        limit = least + TUNING.decisive * noise**2
    if not fitting:
        return None
    best = min(fitting, key=lambda solution: solution[2])
    others = [s for s in fitting if s[2] < limit and not _are_alike(best, s, same)]
    return None if others else best


def meets_another(solution: Solution, others: Sequence[tuple[Array, Array]]) -> bool:
    """Whether another solution of three lights is so near that either may be the right one."""
    rotation = rotation_of(solution[0])
    angles = [_angle(rotation, rvec) for rvec, _ in others]
    return any(TUNING.one < angle < TUNING.meeting for angle in angles)


def _nearest(last: Array, fitting: Sequence[Solution]) -> Solution | None:
    """The solution that goes on from the last pose."""
    angles = [_angle(last, solution[0]) for solution in fitting]
    chosen = fitting[int(np.argmin(angles))]
    same = [solution for solution in fitting if _are_alike(chosen, solution)]
    others = [a for a, s in zip(angles, fitting, strict=True) if not _are_alike(chosen, s)]
    if min(others, default=math.inf) < min(angles) + TUNING.nearer:
        return None
    # Some starts come to a halt before the minimum that they share with others.
    return min(same, key=lambda solution: solution[2])


def _are_alike(a: Solution, b: Solution, same: float = TUNING.same) -> bool:
    return _angle(rotation_of(a[0]), b[0]) < same


def _tilt(solution: Solution) -> float:
    """From the line of sight to the body's x axis, rad."""
    rvec, tvec, _ = solution
    ahead = float(rotation_of(rvec)[:, 0] @ tvec.reshape(3)) / float(np.linalg.norm(tvec))
    return math.acos(min(1.0, max(-1.0, ahead)))


def _angle(rotation: Array, rvec: Array) -> float:
    trace = float(np.sum(rotation * rotation_of(rvec)))
    return math.acos(min(1.0, max(-1.0, 0.5 * (trace - 1.0))))

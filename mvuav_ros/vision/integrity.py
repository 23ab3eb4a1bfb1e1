"""Protection levels: bounds that the error of a pose exceeds with a stated probability only.

Multiple-hypothesis solution separation (Blanch et al., 2015); docs/integrity.md derives it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from itertools import combinations
from statistics import NormalDist
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.approach_results import UNKNOWN_VARIANCE
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.reprojection import Reprojection
from mvuav_ros.vision.rig import MarkerRig

Array = NDArray[np.float64]

_GAUSSIAN = NormalDist()

MIN_LIGHTS = 4  # three lights fit a pose wherever they are, so they cannot check each other
MAX_LIGHTS = 12  # the pairs of more would cost more than they gain; those seen first are used
MAX_TURN_SIGMA = 0.05
"""rad. A hypothesis whose remaining lights determine a turn less exactly is not monitored:
the second, mirrored solution of three lights seen face on is then near, and no Gaussian."""
MAX_DISTANCE_SIGMA = 0.03
"""Of the distance: likewise for the place, where the projection is no longer linear."""
MAX_TURN_LEVEL = 0.15
"""rad. A turn has no level beyond this: the error of three lights seen face on is not Gaussian
there, as flights with two faulty lights show."""
MAX_DISTANCE_LEVEL = 0.1
"""Of the distance: the pose has no levels beyond this, as the projection is not linear there."""
MAX_UNMONITORED = 0.9  # part of the integrity risk that hypotheses without a check may take up
MAX_TAIL = 1e-3
"""The largest probability that a bound is exceeded under its hypothesis, however improbable that
is: a margin for priors that are too small."""
RUNWAY_INFLATION = 6.0
"""By which the deviations of a runway's guidance are multiplied. The factor that makes 95 % of the
errors of real approaches right is 1.6 to 1.7 (three flights, two of them for the third; labels of
whole pixels included): the rest is a margin for other flights.
See tools/evaluate_runway_levels.py."""
MAX_ROLL_SIGMA = math.radians(9.0)
"""rad, of the roll, above which nothing is promised of offset and heading: no horizon shows it."""
MIN_NOISE = 0.05  # px (1 sigma) per axis, of a light's place: less is not believed of residuals
_COORDINATES = 6
_RIDGE = 1e-12
"""Of the information's scale: makes that of a degenerate set of lights invertible, and its
deviations enormous."""


class IntegrityState(IntEnum):
    """Whether a pose may be used, as its protection levels say."""

    AVAILABLE = 0
    ALERT = 1
    NOT_AVAILABLE = 2


@dataclass(frozen=True)
class IntegrityBudget:
    """What is assumed of faults, and what may remain; errors are standard deviations.

    Why they are what they are is in docs/integrity.md. The node's parameters have the limits of
    each.
    """

    risk: float = 1e-7  # probability per frame that the error of any coordinate exceeds its level
    # Probability per frame that a light is not where its marker is, or is another light.
    light_prior: float = 1e-4
    focal_error: float = 0.001  # of the calibrated focal length, as a part of it
    center_error: float = 0.2  # of the calibrated principal point, px per axis


class Levels:
    """Bounds of errors, which are its fields; NaN where there are none, with the ``reason``."""

    __slots__ = ()
    subject: ClassVar[str]  # whose errors they are
    limited: ClassVar[tuple[str, ...]]  # those that have an alert limit, m
    others: ClassVar[tuple[str, ...]] = ()  # m, which follow from these
    angles: ClassVar[tuple[str, ...]]  # rad
    reason: str  # why there are no levels; empty if there are

    @property
    def named(self) -> dict[str, float]:
        """All of them by their names, m; in degrees where the name says so."""
        metres = {name: getattr(self, name) for name in (*self.limited, *self.others)}
        return metres | {f'{name}_deg': math.degrees(getattr(self, name)) for name in self.angles}

    def beyond(self, alert_limits: Sequence[float]) -> list[str]:
        """Which are beyond the limits (m) of ``limited``; a limit of zero is none."""
        levels, limits = self.named, zip(self.limited, alert_limits, strict=True)
        return [axis for axis, limit in limits if limit and levels[axis] > limit]


@dataclass(frozen=True, slots=True)
class ProtectionLevels(Levels):
    """Bounds of one pose's errors, of the rig's dock."""

    subject, limited = 'pose', ('along', 'across', 'up')
    others, angles = ('horizontal', 'vertical'), ('roll', 'pitch', 'yaw')

    along: float = math.nan  # along the line of sight (optical z), m
    across: float = math.nan  # to the right or left (optical x), m
    up: float = math.nan  # up or down (optical y), m
    roll: float = math.nan  # about the line of sight, rad; NaN where a turn could be large
    pitch: float = math.nan  # about optical x, rad
    yaw: float = math.nan  # about optical y, rad
    reason: str = ''

    @property
    def horizontal(self) -> float:
        """In the plane of the line of sight and optical x, m."""
        return math.hypot(self.along, self.across)

    @property
    def vertical(self) -> float:
        """Perpendicular to that plane, m."""
        return self.up


@dataclass(frozen=True, slots=True)
class RunwayLevels(Levels):
    """Bounds of the errors of a runway's guidance."""

    subject, limited, angles = 'runway', ('offset', 'height'), ('heading',)

    offset: float = math.nan  # lateral, m
    height: float = math.nan  # m
    heading: float = math.nan  # rad
    reason: str = ''


def integrity_state(levels: Levels, alert_limits: Sequence[float]) -> IntegrityState:
    """Whether what the levels bound may be used, as alert limits (m; zero: none) ask for."""
    if levels.reason:
        return IntegrityState.NOT_AVAILABLE
    return IntegrityState.ALERT if levels.beyond(alert_limits) else IntegrityState.AVAILABLE


def runway_levels(covariance: Array, confidence: float, risk: float) -> RunwayLevels:
    """How wrong the guidance from a runway's two edges may be.

    Two edges cannot check each other. That they are not the runway's has the probability of one
    minus the confidence; only what this leaves of the risk bounds the Gaussian errors, whose
    deviations are inflated by `RUNWAY_INFLATION`. There are no levels where no horizon shows
    the roll, with which offset and heading turn.

    Args:
        covariance: (6, 6) of x, y, z (m), roll, pitch, yaw (rad), as `Guidance.covariance`.
        confidence: of the runway.
        risk: probability per frame that an error exceeds its level.

    Examples:
        >>> import numpy as np
        >>> levels = runway_levels(np.diag([1.0, 0.04, 0.01, 1e-4, 1e-4, 1e-4]), 0.99, 0.05)
        >>> round(levels.offset, 2), round(levels.height, 2)
        (2.97, 1.48)
        >>> runway_levels(1e-4 * np.eye(6), 0.9, 1e-7).reason
        'a confidence of 0.900 cannot bear a risk of 1e-07'
    """
    variances = [float(covariance[axis, axis]) for axis in (1, 2, 5)]
    if not all(0.0 <= variance < UNKNOWN_VARIANCE for variance in variances):
        return RunwayLevels(reason='the edges do not tell offset, height and heading')
    if not covariance[3, 3] <= MAX_ROLL_SIGMA**2:
        return RunwayLevels(reason='no horizon tells the roll: give attitude')
    left = risk - (1.0 - confidence)
    if not left >= (1.0 - MAX_UNMONITORED) * risk:
        return RunwayLevels(
            reason=f'a confidence of {confidence:.3f} cannot bear a risk of {risk:g}'
        )
    factor = -RUNWAY_INFLATION * _GAUSSIAN.inv_cdf(left / (2.0 * len(variances)))
    offset, height, heading = (factor * math.sqrt(variance) for variance in variances)
    return RunwayLevels(offset, height, heading)


def protection_levels(
    camera: CameraModel,
    rig: MarkerRig,
    labels: Sequence[int],
    pixels: Array,
    rotation: Array,
    translation: Array,
    noise: float,
    budget: IntegrityBudget = IntegrityBudget(),
) -> ProtectionLevels:
    """How wrong a pose may be.

    The place that is bounded is the rig's dock: the pose of a body whose origin is far from its
    lights has errors of the turn in the place of the origin.

    Args:
        camera: calibrated.
        rig: whose lights were seen.
        labels: of these lights, by their place in the rig.
        pixels: (n, 2), where, px.
        rotation: (3, 3), optical frame from the body's, of the pose that is published.
        translation: (3,), of the body's origin, m.
        noise: standard deviation of a light's place per axis, px.
        budget: of risks.

    Examples:
        >>> import cv2, numpy as np
        >>> from mvuav_ros import CameraModel
        >>> from mvuav_ros.vision.frames import OPTICAL_FROM_BODY
        >>> from mvuav_ros.vision.rig import TANKER_747
        >>> camera = CameraModel(640, 480, k=(600, 0, 320, 0, 600, 240, 0, 0, 1))
        >>> place = np.array([2.0, -1.0, 157.0])
        >>> rvec = cv2.Rodrigues(OPTICAL_FROM_BODY)[0]
        >>> seen = cv2.projectPoints(TANKER_747.positions, rvec, place, camera.matrix, None)[0]
        >>> levels = protection_levels(
        ...     camera, TANKER_747, range(5), seen.reshape(-1, 2), OPTICAL_FROM_BODY, place, 0.1
        ... )
        >>> round(levels.along, 2), round(levels.across, 2)
        (0.95, 0.25)
        >>> protection_levels(
        ...     camera, TANKER_747, range(3), seen[:3, 0], OPTICAL_FROM_BODY, place, 0.1
        ... ).reason
        '3 lights cannot check each other: levels need 4'
    """
    used = list(labels)[:MAX_LIGHTS]
    count = len(used)
    if count < MIN_LIGHTS:
        return ProtectionLevels(
            reason=f'{count} lights cannot check each other: levels need {MIN_LIGHTS}'
        )
    view = Reprojection(camera, rig.positions[used] - rig.dock, pixels[:count])
    at_dock = view.look(rotation, translation + rotation.dot(rig.dock))
    design = _design(camera, view.image, *at_dock, budget) / max(noise, MIN_NOISE)
    # Each light's part of the normal equations, six rows of ten.
    terms = (design[:, :, :6].transpose(0, 2, 1) @ design).reshape(count, 60)
    sums = _hypotheses(count)[0] @ terms
    scale = sums[0, :60:11]
    if not scale.min() > 0.0 or not math.isfinite(scale.max()):
        return ProtectionLevels(reason='the lights do not tell a pose')
    sums[:, :60:11] += _RIDGE * scale
    information = sums.reshape(-1, 6, 10)
    covariances = np.linalg.inv(information[:, :, :6])
    shifts = covariances @ information[:, :, 6:]
    by_calibration = shifts[:, :, :3]
    variances = np.einsum('kii->ki', covariances)
    variances = variances + np.einsum('kij,kij->ki', by_calibration, by_calibration)
    distance = rig.distance(rotation, translation)
    limits = np.array([(MAX_DISTANCE_SIGMA * distance) ** 2] * 3 + [MAX_TURN_SIGMA**2] * 3)
    # Rounding may make the variance of a degenerate set negative.
    monitored = ((variances >= 0.0) & (variances <= limits)).all(axis=1)
    factors = _factors(budget, count, monitored.tobytes())
    if factors is None:
        return ProtectionLevels(reason=_unmonitored_reason(monitored, used, rig))
    bounds = np.abs(shifts[:, :, 3]) + factors * np.sqrt(np.abs(variances))
    levels = bounds[monitored].max(axis=0)
    # A turn is bounded under every hypothesis, or not at all.
    levels[3:] = bounds[:, 3:].max(axis=0)
    if not levels[:3].max() <= MAX_DISTANCE_LEVEL * distance:
        return ProtectionLevels(reason='the lights contradict each other or the pose')
    levels[3:][~(levels[3:] <= MAX_TURN_LEVEL)] = math.nan
    across, up, along, pitch, yaw, roll = levels.tolist()
    return ProtectionLevels(along, across, up, roll, pitch, yaw)


@lru_cache(maxsize=32)
def _hypotheses(count: int) -> tuple[Array, NDArray[np.intp]]:
    """No light, each light, each pair is wrong: (m, n) of the lights kept, (m, 2) of the wrong.

    An index of n stands for no light.
    """
    wrong = [(count, count)]
    wrong += [(light, count) for light in range(count)]
    wrong += list(combinations(range(count), 2))
    indices = np.array(wrong, np.intp)
    kept = np.ones((len(wrong), count + 1))
    kept[np.arange(len(wrong))[:, None], indices] = 0.0
    return np.ascontiguousarray(kept[:, :count]), indices


@lru_cache(maxsize=256)
def _factors(budget: IntegrityBudget, count: int, monitored: bytes) -> Array | None:
    """(m, 1), how many deviations of each hypothesis the error may be; None with no risk left."""
    indices = _hypotheses(count)[1]
    is_monitored = np.frombuffer(monitored, np.bool_)
    priors = budget.light_prior ** (indices < count).sum(axis=1)
    # Union bound of three lights or more at once.
    beyond_pairs = math.comb(count, 3) * budget.light_prior**3
    left = budget.risk - float(priors[~is_monitored].sum()) - beyond_pairs
    if not is_monitored[0] or left < (1.0 - MAX_UNMONITORED) * budget.risk:
        return None
    share = left / (_COORDINATES * float(is_monitored.sum()))
    tails = np.minimum(share / np.maximum(priors, share), MAX_TAIL) / 2.0
    return np.array([[-_GAUSSIAN.inv_cdf(tail)] for tail in tails.tolist()])


def _design(
    camera: CameraModel, pixels: Array, seen: Array, slopes: Array, budget: IntegrityBudget
) -> Array:
    """(n, 2, 10), of lights that should be seen somewhere with slopes (2n, 6) by turn and place.

    By the place and the turns, by the three errors of the calibration, one deviation each; and the
    residual.
    """
    design = np.empty((len(seen), 2, 10))
    design[:, :, :6] = np.roll(slopes.reshape(-1, 2, 6), 3, axis=2)
    # A longer focal length moves a pixel away from the principal point, in proportion.
    design[:, :, 6] = (seen - camera.matrix[:2, 2]) * budget.focal_error
    design[:, :, 7:9] = np.eye(2) * budget.center_error
    design[:, :, 9] = pixels - seen
    return design


def _unmonitored_reason(monitored: NDArray[np.bool_], labels: list[int], rig: MarkerRig) -> str:
    """Which faults the lights cannot check."""
    if not monitored[0]:
        return 'the lights do not tell the pose well enough'
    single = monitored[1 : len(labels) + 1].tolist()
    singles = [rig.names[label] for label, fine in zip(labels, single, strict=True) if not fine]
    if singles:
        return f'nothing checks {", ".join(singles)}: the other lights do not tell a pose'
    return 'faults of several lights at once are too probable for the integrity risk'

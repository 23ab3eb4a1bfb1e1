"""Protection levels against the truth: flights of bare lights with faults."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import cv2
import numpy as np
from scipy.special import betaincinv

from mvuav_ros.offline.evaluation.metrics import Array
from mvuav_ros.offline.report import Figure, Report, Section, Table
from mvuav_ros.offline.report_figures import SOFT, THESIS, drawing, label
from mvuav_ros.offline.tasks import all_of
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, Matrix, from_rpy
from mvuav_ros.vision.integrity import (
    IntegrityBudget,
    IntegrityState,
    integrity_state,
    protection_levels,
)
from mvuav_ros.vision.pose import PoseEstimator
from mvuav_ros.vision.rig import TANKER_747

COORDINATES = ('along', 'across', 'up', 'roll', 'pitch', 'yaw')
FAULTS = ('stolen light', 'drifting light', 'biased centroid', 'joined lights')
ALERT_LIMITS = (3.0, 0.5, 0.5)
"""m, along, across and up, at `DISTANCE`."""
DISTANCE = 120.0
"""m, of every other flight; the rest are from `_NEAR` to `_FAR`."""
_NEAR, _FAR = 40.0, 150.0
_FRAMES = 5000
"""In one flight."""
_RATE, _FOCAL, _CENTER = 30.0, 600.0, (320.0, 240.0)
_NOISE = 0.1
"""px per axis, one standard deviation."""
_LONGEST_FAULT = 19
"""Frames; a fault lasts from one frame to this."""
_AMPLITUDES = np.array((8.0, 5.0, 4.0, *np.radians((20.0, 6.0, 6.0))))
"""m aside, up and along, then rad of roll, pitch and yaw."""
_BINS = np.logspace(-3.0, 1.0, 61)
"""Of errors and levels in units of the axis's scale."""
_SCALES = (3.0, 0.5, 0.5, 0.05, 0.05, 0.05)
_MAX_SHOWN = 12


@dataclass
class ProtectionCounts:
    """What became of the frames."""

    frames: int = 0
    faulty: int = 0  # with at least one faulty light
    available: int = 0  # without a fault at `DISTANCE`, and levels within the alert limits
    at_distance: int = 0  # without a fault at `DISTANCE`
    alerts: int = 0  # with a level beyond its alert limit
    silent: int = 0  # without levels, or without a pose
    misleading: int = 0  # with levels of which at least one was exceeded by its error
    hazardous: int = 0  # misleading, and beyond the alert limit without an alert
    # (6, bins, bins), of errors by levels, in units of `_SCALES`
    stanford: Array = field(default_factory=lambda: np.zeros((6, len(_BINS) - 1, len(_BINS) - 1)))
    # of misleading frames: seed, frame, faulty lights, worst error over level
    failures: list[tuple[int, int, str, str]] = field(default_factory=list)

    def add(self, other: ProtectionCounts) -> None:
        """Count the other's frames, too."""
        for name, value in vars(other).items():
            setattr(self, name, getattr(self, name) + value)

    def misleading_bound(self) -> float:
        """Upper bound (95 %, Clopper and Pearson) of the rate of misleading frames."""
        if self.misleading >= self.frames:
            return 1.0
        return float(betaincinv(self.misleading + 1, self.frames - self.misleading, 0.95))


class _Fault:
    """What is wrong with one of so many lights for some frames."""

    def __init__(self, rng: np.random.Generator, light: int, lights: int) -> None:
        self.left = int(rng.integers(1, _LONGEST_FAULT + 1))
        self.kind = FAULTS[rng.integers(len(FAULTS))]
        angle = rng.uniform(0.0, 2.0 * math.pi)
        direction = np.array((math.cos(angle), math.sin(angle)))
        pushes = {'stolen light': (2.0, 40.0), 'biased centroid': (0.1, 1.0)}
        self.push = direction * rng.uniform(*pushes.get(self.kind, (0.0, 0.0)))
        self.rate = direction * (rng.uniform(0, 0.3) if self.kind == 'drifting light' else 0.0)
        self.other = (light + rng.integers(1, lights)) % lights
        self.share = rng.uniform(0.0, 0.5)

    def applied(self, light: int, true: Array) -> Array:
        """Where the light seems to be; the true places are those of all lights (n, 2)."""
        self.left -= 1
        self.push += self.rate
        place: Array = true[light] + self.push
        if self.kind == 'joined lights':
            place += self.share * (true[self.other] - true[light])
        return place


class _Faults:
    """Lights that are wrong for a while, each with a probability per frame of being so."""

    def __init__(self, rng: np.random.Generator, prior: float) -> None:
        self._rng = rng
        # A fault that lasts m frames on average begins with a probability of about p / m.
        mean = (1 + _LONGEST_FAULT) / 2
        self._begins = prior / (mean - prior * (mean - 1.0))
        self._of: dict[int, _Fault] = {}

    def apply(self, pixels: Array) -> list[int]:
        """Spoil the pixels (n, 2) in place; the lights that are wrong."""
        for light in np.flatnonzero(self._rng.random(len(pixels)) < self._begins).tolist():
            if light not in self._of:
                self._of[light] = _Fault(self._rng, light, len(pixels))
        bad, true = sorted(self._of), pixels.copy()
        for light in bad:
            pixels[light] = self._of[light].applied(light, true)
        self._of = {light: fault for light, fault in self._of.items() if fault.left}
        return bad


def fly(
    seed: int, *, budget: IntegrityBudget, factor: float = 1.0, frames: int = _FRAMES
) -> ProtectionCounts:
    """Fly once, and hold every level against the error.

    The prior with which faults are injected is multiplied by ``factor``. No image is drawn: the
    true places of the lights with noise, faults and an error of the calibration go to the pose
    estimator, and its pose to the protection levels.
    """
    rng = np.random.default_rng((2011, seed))
    rig, dock = TANKER_747, np.array(TANKER_747.dock)
    k = (_FOCAL, 0.0, _CENTER[0], 0.0, _FOCAL, _CENTER[1], 0.0, 0.0, 1.0)
    camera, estimator = CameraModel(640, 480, k=k), PoseEstimator(rig)
    focal = _FOCAL * (1.0 + budget.focal_error * rng.normal())
    center = np.array(_CENTER) + budget.center_error * rng.normal(size=2)
    is_far = seed % 2 == 0
    distance = DISTANCE if is_far else rng.uniform(_NEAR, _FAR)
    phases, rates = rng.uniform(0.0, 2.0 * math.pi, 6), rng.uniform(0.1, 0.6, 6)
    faults = _Faults(rng, factor * budget.light_prior)
    counts = ProtectionCounts(frames=frames)
    ratios: list[tuple[Array, Array]] = []
    for index in range(frames):
        time = index / _RATE
        moved = _AMPLITUDES * np.sin(rates * time + phases)
        rotation = OPTICAL_FROM_BODY @ from_rpy(*moved[3:].tolist())
        place = np.array((moved[0], moved[1], distance + moved[2]))
        points = rig.positions @ rotation.T + (place - rotation @ dock)
        pixels = points[:, :2] / points[:, 2:] * focal + center
        pixels += rng.normal(0.0, _NOISE, pixels.shape)
        bad = faults.apply(pixels)
        counts.faulty += bool(bad)
        counts.at_distance += is_far and not bad
        pose = estimator.estimate(camera, range(len(pixels)), pixels, round(time * 1e9))
        if pose is None:
            counts.silent += 1
            continue
        levels = protection_levels(
            camera,
            rig,
            range(len(pixels)),
            pixels,
            pose.rotation,
            pose.translation,
            estimator.noise,
            budget,
        )
        state = integrity_state(levels, ALERT_LIMITS)
        if state is IntegrityState.NOT_AVAILABLE:
            counts.silent += 1
            continue
        counts.alerts += state is IntegrityState.ALERT
        counts.available += is_far and not bad and state is IntegrityState.AVAILABLE
        error = _error(pose.rotation, pose.translation + pose.rotation @ dock, rotation, place)
        bounds = np.array([getattr(levels, name) for name in COORDINATES])
        ratios.append((error, bounds))
        if (error > bounds).any():
            counts.misleading += 1
            beyond = (error[:3] > ALERT_LIMITS).any()
            counts.hazardous += bool(beyond and state is IntegrityState.AVAILABLE)
            worst = int(np.nanargmax(error / bounds))
            text = f'{COORDINATES[worst]} {error[worst]:.3g}, level {bounds[worst]:.3g}'
            names = ', '.join(rig.names[light] for light in bad)
            counts.failures.append((seed, index, names, text))
    _count_stanford(counts, ratios)
    return counts


def _error(rotation: Matrix, place: Array, true_rotation: Matrix, true_place: Array) -> Array:
    """(6,), absolute, in the order of `COORDINATES`."""
    x, y, z = (place - true_place).tolist()
    pitch, yaw, roll = cv2.Rodrigues(rotation @ true_rotation.T)[0].ravel().tolist()
    return np.abs(np.array((z, x, y, roll, pitch, yaw), np.float64))


def _count_stanford(counts: ProtectionCounts, ratios: Sequence[tuple[Array, Array]]) -> None:
    if not ratios:
        return
    errors, bounds = (np.array(each) for each in zip(*ratios, strict=True))
    for axis, scale in enumerate(_SCALES):
        known = np.isfinite(bounds[:, axis])
        error, bound = (
            np.clip(values[known, axis] / scale, _BINS[0], _BINS[-1]) for values in (errors, bounds)
        )
        counts.stanford[axis] += np.histogram2d(error, bound, bins=[_BINS, _BINS])[0]


def run(
    budget: IntegrityBudget,
    frames: int,
    factor: float,
    seed: int,
    jobs: int,
    advance: Callable[[], None],
) -> ProtectionCounts:
    """At least as many frames as asked for; ``advance`` is called after each flight."""
    work = partial(fly, budget=budget, factor=factor, frames=min(_FRAMES, frames))
    total = ProtectionCounts()
    for counts in all_of(work, range(seed, seed + flights_of(frames)), jobs, advance):
        total.add(counts)
    return total


def flights_of(frames: int) -> int:
    """Into how many flights the frames are divided."""
    return -(-frames // _FRAMES)


def protection_report(
    budget: IntegrityBudget, runs: Sequence[tuple[float, ProtectionCounts]], seed: int
) -> Report:
    """Counts beside the stated risk, and a Stanford diagram for each coordinate."""
    rows = [
        (
            factor,
            counts.frames,
            counts.faulty,
            counts.misleading,
            counts.hazardous,
            f'{counts.misleading_bound():.2g}',
            f'{factor * budget.risk:.2g}',
            100.0 * counts.alerts / counts.frames,
            100.0 * counts.silent / counts.frames,
            100.0 * counts.available / counts.at_distance if counts.at_distance else None,
        )
        for factor, counts in runs
    ]
    table = Table.of(
        'protection',
        'Levels against errors',
        'faults, times the prior .0 | frames | with a fault | misleading | beyond the limit, '
        'no alert | rate, 95 % bound | stated risk | alert [%] .2 | not available [%] .2 | '
        f'available without a fault at {DISTANCE:g} m [%] .2',
        rows,
        'Misleading: at least one of six errors is greater than its level. The bound is of '
        'Clopper and Pearson. The stated risk is multiplied like the priors.',
        f'Alert limits: {ALERT_LIMITS[0]:g} m along, {ALERT_LIMITS[1]:g} m across and up.',
    )
    failures = [
        (factor, *failure) for factor, counts in runs for failure in counts.failures[:_MAX_SHOWN]
    ]
    items: list[Table | Figure] = [table, *(_stanford_figure(*each) for each in runs)]
    if failures:
        heading = 'faults, times the prior .0 | seed | frame | faulty lights | worst'
        note = f'The first {_MAX_SHOWN} of each row above.'
        items.append(Table.of('misleading', 'Misleading frames', heading, failures, note))
    return Report(
        'Protection levels of the pose',
        (
            'Bare lights of the built-in tanker, with noise, an error of the calibration in each '
            'flight, and faults: ' + ', '.join(FAULTS) + '.',
        ),
        {'first seed': seed, 'noise [px]': _NOISE, **vars(budget)},
        (Section('Results', (), tuple(items)),),
    )


def _stanford_figure(factor: float, counts: ProtectionCounts) -> Figure:
    """Error against level; below the diagonal the level holds."""
    units = ('m', 'm', 'm', 'rad', 'rad', 'rad')
    with drawing(9.6, 6.4) as canvas:
        panels = canvas.figure.subplots(2, 3).ravel()
        for axis, axes in enumerate(panels):
            edges = _BINS * _SCALES[axis]
            shown = np.where(counts.stanford[axis] > 0, counts.stanford[axis], np.nan)
            axes.pcolormesh(edges, edges, np.log10(shown.T), cmap='viridis')
            axes.plot(edges, edges, color=THESIS, lw=1.2)
            if axis < len(ALERT_LIMITS):
                axes.axhline(ALERT_LIMITS[axis], color=SOFT, ls='--', lw=1.0)
            axes.set_xscale('log')
            axes.set_yscale('log')
            unit = units[axis]
            label(axes, COORDINATES[axis], f'error [{unit}]', f'level [{unit}]')
    return canvas.as_figure(
        f'stanford_{factor:g}',
        f'Stanford diagrams, faults {factor:g} times as frequent as stated',
        'Error against protection level in six panels; all frames should lie above the diagonal',
        'Red: error equal to the level; frames below it are misleading. Dashed: the alert limit.',
    )

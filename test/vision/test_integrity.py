import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, from_rpy
from mvuav_ros.vision.integrity import (
    IntegrityBudget,
    IntegrityState,
    ProtectionLevels,
    integrity_state,
    protection_levels,
    runway_levels,
)
from mvuav_ros.vision.rig import TANKER_747, MarkerRig

CAMERA = CameraModel(640, 480, k=(600, 0, 320, 0, 600, 240, 0, 0, 1))
ROTATION = OPTICAL_FROM_BODY @ from_rpy(0.1, 0.05, -0.04)
PLACE = np.array((3.0, -2.0, 120.0)) - ROTATION @ TANKER_747.dock
EVERYTHING = range(5)
BUDGET = IntegrityBudget()


def seen(
    camera: CameraModel = CAMERA, rig: MarkerRig = TANKER_747, place: NDArray[np.float64] = PLACE
) -> NDArray[np.float64]:
    rvec = cv2.Rodrigues(ROTATION)[0]
    projected = cv2.projectPoints(rig.positions, rvec, place, camera.matrix, camera.distortion)
    return np.asarray(projected[0].reshape(-1, 2))


def levels(
    pixels: NDArray[np.float64] | None = None,
    labels: range | list[int] = EVERYTHING,
    budget: IntegrityBudget = BUDGET,
    **given: object,
) -> ProtectionLevels:
    pixels = seen()[list(labels)] if pixels is None else pixels
    arguments = {'rotation': ROTATION, 'translation': PLACE, 'noise': 0.1, **given}
    return protection_levels(CAMERA, TANKER_747, labels, pixels, budget=budget, **arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize('budget', [BUDGET, IntegrityBudget(risk=1e-3, light_prior=1e-2)])
def test_as_computed_one_hypothesis_at_a_time(budget: IntegrityBudget) -> None:
    # Independent of the code's sums: whole design matrices, numeric derivatives, one by one.
    from itertools import combinations

    from scipy.special import ndtri

    pixels = seen() + np.random.default_rng(5).normal(0.0, 0.1, (5, 2))
    dock = np.array(TANKER_747.dock)

    def project(values: NDArray[np.float64]) -> NDArray[np.float64]:
        turned = cv2.Rodrigues(values[3:6])[0] @ ROTATION
        place = PLACE + ROTATION @ dock + values[:3]
        points = (TANKER_747.positions - dock) @ turned.T + place
        focal, center = 600 * (1 + values[6]), np.array((320, 240)) + values[7:9]
        return np.asarray((points[:, :2] / points[:, 2:] * focal + center).ravel())

    steps = 1e-6 * np.eye(9)
    design = np.stack([(project(s) - project(-s)) / 2e-6 for s in steps], axis=1)
    residual = pixels.ravel() - project(np.zeros(9))
    bounds, turns = [], []
    hypotheses = [wrong for count in range(3) for wrong in combinations(range(5), count)]
    unmonitored = 0.0
    solutions = {}
    for wrong in hypotheses:
        rows = [row for row in range(10) if row // 2 not in wrong]
        inverse = np.linalg.pinv(design[rows, :6])
        errors = np.array((budget.focal_error, budget.center_error, budget.center_error))
        by_calibration = inverse @ (design[rows, 6:] * errors)
        sigma = np.sqrt(0.1**2 * (inverse**2).sum(axis=1) + (by_calibration**2).sum(axis=1))
        if sigma[3:].max() > 0.05:
            unmonitored += budget.light_prior ** len(wrong)
        solutions[wrong] = np.abs(inverse @ residual[rows]), sigma
    monitored = {wrong: each for wrong, each in solutions.items() if each[1][3:].max() <= 0.05}
    assert 10 < len(monitored) < len(solutions) == 16
    triples = 10 * budget.light_prior**3
    share = (budget.risk - unmonitored - triples) / (6 * len(monitored))
    for wrong, (shift, sigma) in solutions.items():
        tail = min(share / max(budget.light_prior ** len(wrong), share), 1e-3)
        bound = shift - ndtri(tail / 2) * sigma
        turns.append(bound[3:])
        if wrong in monitored:
            bounds.append(bound[:3])
    x, y, z = np.max(bounds, axis=0)
    pitch, yaw, roll = np.where(np.max(turns, axis=0) <= 0.15, np.max(turns, axis=0), np.nan)
    found = levels(pixels, budget=budget)
    assert found.along == pytest.approx(z, rel=1e-4)
    assert (found.across, found.up) == pytest.approx((x, y), rel=1e-4)
    assert (found.roll, found.pitch, found.yaw) == pytest.approx(
        (roll, pitch, yaw), rel=1e-3, nan_ok=True
    )
    assert math.isfinite(found.roll)


def test_a_pose_that_is_off_has_levels_that_cover_it() -> None:
    # However the pose was made, the lights say how far off it is.
    for axis, name in enumerate(('across', 'up', 'along')):
        moved = PLACE + np.eye(3)[axis] * 2.0
        assert getattr(levels(translation=moved), name) > 2.0
    turned = from_rpy(0.0, 0.0, 0.05) @ ROTATION
    place = PLACE + ROTATION @ TANKER_747.dock - turned @ TANKER_747.dock
    assert levels(rotation=turned, translation=place).roll > 0.05


@pytest.mark.parametrize('light', EVERYTHING)
def test_a_light_that_is_wrong_widens_the_levels_beyond_the_error(light: int) -> None:
    known = 0
    for push in ((0.5, 0.0), (0.0, -1.5), (3.0, 3.0)):
        pixels = seen()
        pixels[light] += push
        rotation, place = solve(pixels)
        found = levels(pixels, rotation=rotation, translation=place)
        error = place + rotation @ TANKER_747.dock - PLACE - ROTATION @ TANKER_747.dock
        if not found.reason:
            known += 1
            assert np.all(np.abs(error) < (found.across, found.up, found.along))
            assert found.along > levels().along
    assert known >= 2


def solve(pixels: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rvec, place = cv2.solvePnPRefineLM(
        TANKER_747.positions,
        pixels,
        CAMERA.matrix,
        None,
        cv2.Rodrigues(ROTATION)[0],
        PLACE.reshape(3, 1).copy(),
    )
    return cv2.Rodrigues(rvec)[0], place.ravel()


def test_levels_grow_with_noise_priors_and_calibration_and_with_a_smaller_risk() -> None:
    usual = levels().along
    assert levels(noise=0.2).along > 1.5 * usual
    for name, value in (('light_prior', 1.2e-4), ('focal_error', 0.01), ('center_error', 5.0)):
        wider = levels(budget=replace(IntegrityBudget(), **{name: value}))
        assert max(wider.along / usual, wider.across / levels().across) > 1.001, name
    assert levels(budget=IntegrityBudget(risk=1e-4)).along < usual


@pytest.mark.parametrize(
    ('given', 'reason'),
    [
        ({'labels': range(3)}, '3 lights cannot check each other'),
        ({'labels': range(0)}, '0 lights cannot check each other'),
        ({'labels': [1, 2, 3, 4]}, 'nothing checks right_wing'),
        ({'budget': IntegrityBudget(light_prior=0.1)}, 'too probable for the integrity risk'),
        ({'translation': np.full(3, math.nan)}, 'do not tell a pose'),
        ({'pixels': np.full((5, 2), math.nan)}, 'contradict'),
        ({'translation': PLACE + np.array((0, 0, 40))}, 'contradict'),
        ({'noise': 20.0}, 'well enough'),
    ],
)
def test_no_level_and_the_reason(given: dict[str, object], reason: str) -> None:
    found = levels(**given)  # type: ignore[arg-type]
    assert reason in found.reason
    assert integrity_state(found, (0.0, 0.0, 0.0)) is IntegrityState.NOT_AVAILABLE
    assert math.isnan(found.along) and math.isnan(found.horizontal) and math.isnan(found.yaw)


def test_a_rig_on_one_line_has_no_level() -> None:
    markers = tuple((f'm{i}', (0.1 * i, 0.3 * i, 0.0)) for i in range(6))
    rig = MarkerRig('line', markers, (0, 0, 0), (0, 0, 0))
    place = np.array((0.0, 0.0, 10.0))
    pixels = seen(rig=rig, place=place)
    found = protection_levels(CAMERA, rig, range(6), pixels, ROTATION, place, 0.1)
    assert found.reason


def test_states_against_limits() -> None:
    found = levels()
    assert integrity_state(found, (0, 0, 0)) is IntegrityState.AVAILABLE
    assert integrity_state(found, (3.0, 0.5, 0.5)) is IntegrityState.AVAILABLE
    assert integrity_state(found, (0.5, 0.5, 0.5)) is IntegrityState.ALERT
    assert found.horizontal == math.hypot(found.along, found.across)
    assert found.vertical == found.up


COVARIANCE = np.diag([100.0, 0.25, 0.16, 1e-4, 1e-4, 4e-4])


def test_runway_levels_are_the_deviations_that_the_risk_asks_for() -> None:
    # 0.03 of the risk is left for three errors, half of it on each side: 2.576 deviations, which
    # are six times those of the covariance.
    found = runway_levels(COVARIANCE, 0.99, 0.04)
    assert (found.offset, found.height) == pytest.approx(
        (6 * 2.576 * 0.5, 6 * 2.576 * 0.4), rel=1e-3
    )
    assert found.heading == pytest.approx(6 * 2.576 * 0.02, rel=1e-3)
    assert integrity_state(found, (8.0, 7.0)) is IntegrityState.AVAILABLE
    assert integrity_state(found, (7.0, 0.0)) is IntegrityState.ALERT
    assert found.beyond((7.0, 0.0)) == ['offset']


@pytest.mark.parametrize('confidence', [0.0, 0.5, 0.95, math.nan])
def test_a_confidence_that_cannot_bear_the_risk_gives_no_level(confidence: float) -> None:
    found = runway_levels(COVARIANCE, confidence, 0.05)
    assert 'cannot bear a risk of 0.05' in found.reason and math.isnan(found.offset)
    assert integrity_state(found, (0.0, 0.0)) is IntegrityState.NOT_AVAILABLE


def test_edges_that_tell_no_place_give_no_level() -> None:
    for variance in (1e12, math.nan):
        unknown = COVARIANCE.copy()
        unknown[2, 2] = variance
        assert 'do not tell' in runway_levels(unknown, 1.0, 0.05).reason


def test_a_roll_that_no_horizon_tells_gives_no_level() -> None:
    unknown = COVARIANCE.copy()
    for variance in (math.radians(10.0) ** 2, math.nan):
        unknown[3, 3] = variance
        assert 'give attitude' in runway_levels(unknown, 1.0, 0.05).reason

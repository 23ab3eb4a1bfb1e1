"""Poses against truth: accuracy, covariance, ambiguity."""

import itertools
import math

import cv2
import numpy as np
import pytest

from mvuav_ros.simulation.settings import TankerSettings
from mvuav_ros.simulation.tanker_flight import TankerFlight
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, from_rpy
from mvuav_ros.vision.integrity import protection_levels
from mvuav_ros.vision.markers.tracker import MarkerTracker
from mvuav_ros.vision.pose import PoseEstimator, _ResidualNoise
from mvuav_ros.vision.reprojection import Reprojection
from mvuav_ros.vision.rig import TANKER_747, MarkerRig, parse_rig
from mvuav_thesis.light_flights import LightFlight, LightScene

CAMERA = CameraModel(640, 480, (554.0, 0.0, 319.5, 0.0, 554.0, 239.5, 0.0, 0.0, 1.0))


def camera_of(flight):
    camera = flight.camera
    return CameraModel(
        camera.width, camera.height, tuple(camera.matrix.ravel()), tuple(camera.distortion)
    )


def angle_between(a, b):
    return float(np.linalg.norm(cv2.Rodrigues(a @ b.T)[0]))


def deviations(pose, truth):
    """Translation error (m) and small turn (rad) of a pose, (6,)."""
    turn = cv2.Rodrigues(pose.rotation @ truth.rotation.T)[0].ravel()
    return np.concatenate((pose.translation - truth.translation, turn))


def docking(seed, frames=1000, noise=0.3, **settings):
    """Poses and truth of a docking approach, the lights seen with noise."""
    flight = TankerFlight(TankerSettings(motion='docking', frames=frames, seed=seed, **settings))
    estimator = PoseEstimator(flight.rig)
    rng = np.random.default_rng(seed)
    camera = camera_of(flight)
    for index in range(frames):
        truth = flight.truth(index)
        pixels = np.array([(m.x, m.y) for m in truth.markers])
        pixels = pixels + rng.normal(0.0, noise, pixels.shape)
        pose = estimator.estimate(camera, range(5), pixels, round(flight.time(index) * 1e9))
        assert pose is not None
        yield pose, truth


@pytest.mark.parametrize(
    'settings',
    [
        pytest.param({}, marks=pytest.mark.long),
        {'distortion': '-0.15, 0.04, 0.001, -0.001'},
    ],
)
def test_docking_approach(settings):
    poses = list(docking(21, **settings))
    near = [(pose, truth) for pose, truth in poses if truth.distance <= 30.0]
    assert len(near) > 400
    distances = [np.linalg.norm(deviations(p, t)[:3]) / t.distance for p, t in near]
    angles = [np.linalg.norm(deviations(p, t)[3:]) for p, t in near]
    assert np.sqrt(np.mean(np.square(distances))) < 0.005
    assert np.percentile(distances, 99.9) < 0.0115
    assert max(angles) < math.radians(0.5)
    # Farther out the turn shows less.
    far = [np.linalg.norm(deviations(p, t)[3:]) for p, t in poses[:100]]
    assert np.mean(far) > 1.5 * np.mean(angles)


@pytest.mark.parametrize(
    'seed', [31, *(pytest.param(seed, marks=pytest.mark.long) for seed in (32, 33))]
)
def test_normalised_error_squared_lies_in_its_band(seed):
    squares = [
        deviations(pose, truth) @ np.linalg.solve(pose.covariance, deviations(pose, truth))
        for pose, truth in docking(seed)
    ]
    # 1000 values of chi-square with 6 degrees of freedom, and the noise is estimated as well.
    assert len(squares) == 1000
    assert np.mean(squares) == pytest.approx(6.0, abs=0.35)
    assert np.mean(np.array(squares) < 12.59) == pytest.approx(0.95, abs=0.02)


def test_poses_from_images():
    flight = TankerFlight(TankerSettings(motion='docking', frames=60, fps=6.0, seed=2))
    camera = camera_of(flight)
    pipeline, estimator = MarkerTracker(), PoseEstimator(flight.rig)
    for index, frame in enumerate(flight):
        markers = pipeline.process(frame.image, frame.stamp_ns).markers
        pixels = np.array([(m.x, m.y) for m in markers])
        pose = estimator.estimate(camera, range(5), pixels, round(flight.time(index) * 1e9))
        error = deviations(pose, frame.truth)
        assert np.linalg.norm(error[:3]) < 0.002 * frame.truth.distance
        assert np.linalg.norm(error[3:]) < math.radians(0.1)
    assert estimator.noise < 0.06


def seen(rotation, translation, layout=TANKER_747, camera=CAMERA):
    points = layout.positions @ rotation.T + translation
    assert points[:, 2].min() > 0
    pixels = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)
    return pixels[0].reshape(-1, 2)


@pytest.mark.parametrize('roll', [-170.0, -60.0, 0.0, 45.0, 120.0])
@pytest.mark.parametrize(('pitch', 'yaw'), [(0.0, 0.0), (20.0, -10.0), (-25.0, 30.0)])
def test_any_attitude_from_one_frame(roll, pitch, yaw):
    angles = np.radians((roll, pitch, yaw))
    rotation = OPTICAL_FROM_BODY @ from_rpy(*angles)
    translation = np.array((5.0, -3.0, 110.0))
    pose = PoseEstimator(TANKER_747).estimate(CAMERA, range(5), seen(rotation, translation), 0)
    assert angle_between(pose.rotation, rotation) < 1e-4
    np.testing.assert_allclose(pose.translation, translation, atol=0.01)
    np.testing.assert_allclose(pose.rpy, angles, atol=1e-4)
    np.testing.assert_allclose(pose.reprojections, seen(rotation, translation), atol=1e-3)
    x, y, z, w = pose.quaternion
    expected = cv2.Rodrigues(rotation)[0].ravel()
    half = 0.5 * np.linalg.norm(expected)
    axis = expected / np.linalg.norm(expected) * math.sin(half)
    quaternion = np.array((*axis, math.cos(half)))
    assert abs(abs(np.dot((x, y, z, w), quaternion)) - 1.0) < 1e-6
    assert w >= 0.0


@pytest.mark.parametrize('distortion', [(), (-0.15, 0.04, 0.001, -0.001, 0.0)])
def test_the_refinement_ends_where_opencvs_does(distortion):
    camera = CameraModel(640, 480, CAMERA.k, distortion)
    rng = np.random.default_rng(4)
    for _ in range(20):
        rotation = OPTICAL_FROM_BODY @ from_rpy(*rng.uniform(-0.4, 0.4, 3))
        translation = rng.uniform((-10, -8, 80), (10, 8, 150))
        image = seen(rotation, translation, camera=camera) + rng.normal(0, 0.3, (5, 2))
        start = rotation @ from_rpy(*rng.normal(0, 0.1, 3))
        view = Reprojection(camera, TANKER_747.positions, image)
        found = view.refine(start, 1.1 * translation)
        rvec, tvec = cv2.Rodrigues(found.rotation)[0], found.translation[:, None]
        model = camera.matrix, camera.distortion
        strict = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-12)
        start = rvec.copy(), tvec.copy()
        best = cv2.solvePnPRefineLM(TANKER_747.positions, image, *model, *start, strict)
        np.testing.assert_allclose(rvec, best[0], atol=1e-6)
        np.testing.assert_allclose(tvec, best[1], atol=1e-4)
        assert found.squares == pytest.approx(((image - found.seen) ** 2).sum())
        # What the steps left is what the solution has, but for the square of the last one.
        places, slopes = view.look(found.rotation, found.translation)
        np.testing.assert_allclose(found.seen, places, atol=1e-5)
        np.testing.assert_allclose(found.slopes, slopes, rtol=1e-3, atol=5e-2)


def test_the_slopes_of_the_last_pose_lead_to_the_same_pose():
    rng = np.random.default_rng(5)
    rotation, translation, last = OPTICAL_FROM_BODY, np.array((2.0, -1.0, 100.0)), None
    for _ in range(20):
        rotation = rotation @ from_rpy(*rng.normal(0, 0.02, 3))
        translation = translation + rng.normal(0, 0.2, 3)
        image = seen(rotation, translation) + rng.normal(0, 0.1, (5, 2))
        view = Reprojection(CAMERA, TANKER_747.positions, image)
        alone = view.refine(rotation, translation)
        last = view.refine(last.rotation, last.translation, last) if last else alone
        np.testing.assert_allclose(last.rotation, alone.rotation, atol=1e-6)
        np.testing.assert_allclose(last.translation, alone.translation, atol=1e-4)
        normal = last.slopes.T @ last.slopes
        np.testing.assert_allclose(normal @ last.spread, np.eye(6), atol=1e-6)


@pytest.mark.parametrize('model', ['plumb_bob', 'equidistant'])
def test_the_slopes_are_the_differences_of_places(model):
    distortion = (-0.15, 0.04, 0.001, -0.001, 0.0) if model == 'plumb_bob' else (0.1, -0.02, 0, 0)
    camera = CameraModel(640, 480, CAMERA.k, distortion, distortion_model=model)
    rotation, translation = OPTICAL_FROM_BODY @ from_rpy(0.2, -0.1, 0.3), np.array((3.0, -2, 60))
    about = np.array((2.0, 1.0, -1.0))

    def places(turn, move):
        turned = cv2.Rodrigues(turn)[0] @ rotation
        # The point about which the body turns stays in its place.
        origin = translation + move + (rotation - turned) @ about
        return camera.project(TANKER_747.positions, cv2.Rodrigues(turned)[0], origin)

    view = Reprojection(camera, TANKER_747.positions - about, np.empty((5, 2)))
    slopes = view.look(rotation, translation + rotation @ about)[1].reshape(-1, 2, 6)
    by_turn, by_place = slopes[..., :3], slopes[..., 3:]
    for axis, step in enumerate(1e-5 * np.eye(3)):
        none = np.zeros(3)
        moved = (places(none, step) - places(none, -step)) / 2e-5
        turned = (places(step, none) - places(-step, none)) / 2e-5
        np.testing.assert_allclose(by_place[..., axis], moved, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(by_turn[..., axis], turned, rtol=1e-4, atol=1e-4)


def test_three_lights_have_several_solutions_and_the_last_pose_decides():
    """Drawn from all five for a while, then the rudder and a stabilizer are hidden."""
    estimator = PoseEstimator(TANKER_747)
    rng = np.random.default_rng(3)
    worst = 0.0
    for index in range(40):
        rotation = OPTICAL_FROM_BODY @ from_rpy(0.01 * index, 0.2, 0.1)
        translation = np.array((0.1 * index, 0.0, 100.0))
        lights = [0, 1, 2, 3, 4] if index < 20 else [0, 1, 4]
        pixels = seen(rotation, translation)[lights] + rng.normal(0, 0.05, (len(lights), 2))
        pose = estimator.estimate(CAMERA, lights, pixels, round(index / 30 * 1e9))
        worst = max(worst, angle_between(pose.rotation, rotation))
    assert worst < math.radians(2.0)


def test_three_lights_give_all_poses_that_fit_them():
    """OpenCV's solvers of three points were never asked: without them one in ten was missing."""
    rng = np.random.default_rng(5)
    for _ in range(100):
        points = rng.uniform(-0.6, 0.6, (3, 3))
        rotation = OPTICAL_FROM_BODY @ from_rpy(*rng.uniform((-3, -0.5, -0.5), (3, 0.5, 0.5)))
        pixels = CAMERA.project(points @ rotation.T + (0.2, 0.1, rng.uniform(2.0, 6.0)))
        view = Reprojection(CAMERA, points, pixels)
        found = view.refined(view.closed_forms())
        assert min(angle_between(each.rotation, rotation) for each in found) < 1e-3


FLAT = parse_rig(
    {'markers': {'a': [0, 1, 1], 'b': [0, -1, 1], 'c': [0, -1, -1], 'd': [0, 1, -1]}}, 'flat'
)


@pytest.mark.parametrize('seed', [40, 322, 417, 584, 755, 1128])
def test_four_lights_have_a_pose_where_sqpnp_has_none(seed):
    """That of OpenCV 5.0 finds no solution in these."""
    rng = np.random.default_rng(seed)
    rotation = OPTICAL_FROM_BODY @ from_rpy(*rng.normal(0.0, 0.3, 3).tolist())
    pixels = seen(rotation, np.array((2.0, -1.0, 120.0))) + rng.normal(0.0, 0.05, (5, 2))
    lights = np.delete(np.arange(5), 4 * (seed % 2))
    view = Reprojection(CAMERA, TANKER_747.positions[lights], pixels[lights])
    best = min(view.solve(), key=lambda solution: solution.squares)
    assert angle_between(best.rotation, rotation) < math.radians(1.0)


def test_three_of_five_lights_only_continue_a_pose():
    """Any three lights fit some pose: a marker that comes back as one of three is not confirmed."""
    rotation, translation = OPTICAL_FROM_BODY @ from_rpy(0.1, 0.2, 0.1), np.array((2.0, 1.0, 90.0))
    pixels = seen(rotation, translation)
    estimator = PoseEstimator(TANKER_747)

    def told(lights, time):
        return estimator.estimate(CAMERA, lights, pixels[lights], round(time * 1e9)) is not None

    assert not told([0, 1, 4], 0.0)
    assert 'confirms' in estimator.reason
    assert told([0, 1, 2, 3, 4], 0.1)
    assert told([0, 1, 4], 0.2)
    assert not told([0, 1], 0.3)
    assert not told([0, 1, 4], 0.4)
    assert told([0, 1, 3, 4], 0.5)
    assert told([0, 1, 4], 0.6)
    assert not told([0, 1, 4], 0.2), 'of a recording that begins anew'


def test_three_lights_continue_a_pose_for_a_moment():
    """Then one of them may have been another light for long, and no other one shows it."""
    rotation, translation = OPTICAL_FROM_BODY @ from_rpy(0.1, 0.2, 0.1), np.array((2.0, 1.0, 90.0))
    pixels = seen(rotation, translation)
    estimator = PoseEstimator(TANKER_747)
    told = []
    for index in range(40):
        lights = [0, 1, 3, 4] if index in (0, 30) else [0, 1, 4]
        pose = estimator.estimate(CAMERA, lights, pixels[lights], round(index / 25 * 1e9))
        told.append(pose is not None)
    assert told == 18 * [True] + 12 * [False] + 10 * [True]


def test_a_flat_body_seen_from_afar_does_not_flip():
    """Tilted one way or the other a distant square looks almost the same: then no pose is told."""
    rng = np.random.default_rng(4)
    estimator = PoseEstimator(FLAT)
    rotation = OPTICAL_FROM_BODY @ from_rpy(0.0, 0.0, 0.4)
    told = kept_back = 0
    for index in range(120):
        translation = np.array((0.0, 0.0, 6.0 + 0.25 * index))
        pixels = seen(rotation, translation, FLAT) + rng.normal(0, 0.1, (4, 2))
        for estimated in (estimator, PoseEstimator(FLAT)):
            pose = estimated.estimate(CAMERA, range(4), pixels, round(index / 30 * 1e9))
            if pose is None:
                kept_back += 1
                assert estimated.reason
            else:
                told += 1
                assert angle_between(pose.rotation, rotation) < math.radians(5.0), index
    assert told > 150
    assert kept_back > 5


def test_a_marker_that_the_others_contradict_is_left_out():
    estimator = PoseEstimator(TANKER_747)
    rng = np.random.default_rng(5)
    for index in range(90):
        rotation = OPTICAL_FROM_BODY @ from_rpy(0.01 * index, 0.1, 0.05)
        translation = np.array((0.05 * index, 0.0, 100.0))
        pixels = seen(rotation, translation) + rng.normal(0, 0.05, (5, 2))
        if 40 <= index < 50:
            pixels[2] += (12.0, -9.0)
        pose = estimator.estimate(CAMERA, range(5), pixels, round(index / 30 * 1e9))
        if pose is not None:
            assert angle_between(pose.rotation, rotation) < math.radians(1.0), index
        assert pose is not None or 40 <= index < 55


def test_the_noise_is_learnt_once_in_a_frame_whatever_is_left_out_of_it(monkeypatch):
    """What several poses fit, of four lights of a body that is nearly flat, is no other frame."""
    learnt, learn = [], _ResidualNoise.learn
    monkeypatch.setattr(
        _ResidualNoise, 'learn', lambda *given: (learnt.append(given[1:]), learn(*given))
    )
    for seed in range(30):
        rng = np.random.default_rng(seed)
        places = enumerate((rng.normal(size=(5, 3)) * (0.02, 10.0, 10.0)).tolist())
        rig = parse_rig({'markers': {f'light {number}': place for number, place in places}})
        pixels = seen(OPTICAL_FROM_BODY @ from_rpy(0.1, -0.1, 0.05), np.array((2, -1, 200.0)), rig)
        pixels[seed % 5] += rng.normal(0.0, 3.0, 2)
        PoseEstimator(rig).estimate(CAMERA, range(5), pixels, 0)
        assert len(learnt) <= 1, (seed, learnt)
        learnt.clear()


def test_a_pose_comes_without_a_reason_why_there_is_none():
    told = withheld = 0
    true = seen(OPTICAL_FROM_BODY, np.array((2.0, -1.0, 120.0)))
    for seed in range(80):
        rng = np.random.default_rng(seed)
        estimator = PoseEstimator(TANKER_747)
        for index in range(15 * (seed % 2)):
            noisy = true + rng.normal(0, 0.1, (5, 2))
            estimator.estimate(CAMERA, range(5), noisy, index * 33_000_000)
        pixels = true + rng.normal(0, 0.1, (5, 2))
        pixels[[seed % 5, (seed + 2) % 5]] += rng.normal(0, 3.0, (2, 2))
        pose = estimator.estimate(CAMERA, range(5), pixels, 40 * 33_000_000)
        assert (pose is None) == bool(estimator.reason), estimator.reason
        told, withheld = told + (pose is not None), withheld + (pose is None)
    assert min(told, withheld) > 5


def test_the_covariance_is_back_to_normal_after_an_upset():
    estimator = PoseEstimator(TANKER_747)
    rng = np.random.default_rng(7)
    deviations = []
    for index in range(120):
        noise = 0.6 if 60 <= index < 70 else 0.05
        pixels = seen(OPTICAL_FROM_BODY, np.array((0.0, 0.0, 100.0))) + rng.normal(0, noise, (5, 2))
        pose = estimator.estimate(CAMERA, range(5), pixels, round(index / 30 * 1e9))
        deviations.append(math.nan if pose is None else math.sqrt(pose.covariance[2, 2]))
    usual = np.nanmean(deviations[40:60])
    assert np.nanmax(deviations[60:70]) > 3.0 * usual
    assert np.nanmax(deviations[85:]) < 1.3 * usual


def test_what_a_caller_does_to_a_pose_changes_no_later_one():
    pixels = seen(OPTICAL_FROM_BODY, np.array((2.0, -1.0, 100.0)))
    estimator = PoseEstimator(TANKER_747)
    for index in range(3):
        pose = estimator.estimate(CAMERA, range(5), pixels, index * 33_000_000)
    for array in (pose.rotation, pose.translation, pose.covariance, pose.reprojections):
        array[:] = 0.0
    after = estimator.estimate(CAMERA, [0, 2, 4], pixels[[0, 2, 4]], 99_000_000)
    assert after.translation == pytest.approx((2.0, -1.0, 100.0), abs=1e-3)


@pytest.mark.parametrize('label', [-1, 5, 3])
def test_a_label_that_the_rig_has_not_or_that_is_there_twice(label):
    pixels = seen(OPTICAL_FROM_BODY, np.array((0.0, 0.0, 100.0)))
    with pytest.raises(ValueError, match='of a rig of 5, each once'):
        PoseEstimator(TANKER_747).estimate(CAMERA, [0, 1, 2, 3, label], pixels, 0)


@pytest.mark.parametrize('labels', [4, 5])
def test_as_many_places_as_labels_are_needed(labels):
    """Four of five labels had no pose, and five of four an IndexError."""
    pixels = seen(OPTICAL_FROM_BODY, np.array((0.0, 0.0, 100.0)))
    with pytest.raises(ValueError, match=f'{labels} labels need as many places'):
        PoseEstimator(TANKER_747).estimate(CAMERA, range(labels), pixels[: 9 - labels], 0)


def test_what_cannot_be_a_pose():
    pixels = seen(OPTICAL_FROM_BODY, np.array((0.0, 0.0, 100.0)))
    unknown = pixels.copy()
    unknown[0, 0] = math.nan
    frames = [
        ([0, 4], pixels[[0, 4]], '2 markers; a pose needs 3'),
        (range(5), pixels[[2, 1, 0, 3, 4]], 'no pose fits the markers'),
        (range(5), unknown, 'the positions of the markers are not finite'),
        # As a lens of senseless coefficients projects.
        (range(5), 1e200 * pixels, 'no pose fits the markers'),
        (range(5), pixels, ''),
        # All in one place.
        (range(5), np.full((5, 2), 300.0), 'the pose is too uncertain'),
    ]
    estimator = PoseEstimator(TANKER_747)
    for index, (labels, places, reason) in enumerate(frames):
        pose = estimator.estimate(CAMERA, labels, places, index * 100_000_000)
        assert (pose is not None, estimator.reason) == (not reason, reason)


def test_a_light_behind_the_camera_is_seen_nowhere():
    places = {'a': [0, 1, 0], 'b': [20, -4, 0], 'c': [30, 5, 0], 'd': [40, -6, 2], 'e': [45, 2, 6]}
    deck = parse_rig({'markers': places})
    above = np.array((0.0, 4.0, -5.0))
    pixels = CAMERA.project(deck.positions @ OPTICAL_FROM_BODY.T + above)
    pose = PoseEstimator(deck).estimate(CAMERA, range(1, 5), pixels[1:], 0)
    assert np.isnan(pose.reprojections[0]).all()
    assert pose.reprojections[1:] == pytest.approx(pixels[1:], abs=1e-3)


@pytest.mark.parametrize('distance', [20.0, 1.0, 0.0])
def test_a_camera_may_come_to_the_origin_of_a_body_whose_lights_are_ahead(distance):
    """As to a place to land at, from where the lights of a deck are seen."""
    places = {'a': [20, 5, 0], 'b': [20, -5, 1], 'c': [21, 3, 5], 'd': [19, -4, 6], 'e': [24, 0, 3]}
    deck, ahead = parse_rig({'markers': places}), np.array((0.0, 0.0, distance))
    pixels = CAMERA.project(deck.positions @ OPTICAL_FROM_BODY.T + ahead)
    estimator = PoseEstimator(deck)
    pose = estimator.estimate(CAMERA, range(5), pixels, 0)
    assert pose is not None, estimator.reason
    assert pose.translation == pytest.approx(ahead, abs=1e-6)
    given = CAMERA, deck, range(5), pixels, pose.rotation, pose.translation, 0.05
    assert protection_levels(*given).reason == ''


def test_the_noise_follows_the_residuals():
    rng = np.random.default_rng(6)
    pixels = seen(OPTICAL_FROM_BODY, np.array((0.0, 0.0, 100.0)))
    for noise in (0.1, 0.6):
        estimator = PoseEstimator(TANKER_747)
        for index in range(300):
            noisy = pixels + rng.normal(0, noise, pixels.shape)
            estimator.estimate(CAMERA, range(5), noisy, round(index / 30 * 1e9))
        assert estimator.noise == pytest.approx(noise, rel=0.1)


@pytest.mark.parametrize('left', [(0, 1, 2, 3), (0, 1, 2)])
def test_four_lights_of_which_one_drifts_away_have_no_pose(left):
    """They fit worse, which of them it is nobody knows, and three of them fit anything."""
    rng = np.random.default_rng(8)
    pixels = seen(OPTICAL_FROM_BODY, np.array((0.0, 0.0, 100.0)))
    estimator, told = PoseEstimator(TANKER_747), []
    for index in range(120):
        drift = max(index - 59, 0)
        labels = range(5) if drift == 0 else [0, 1, 2, 3] if drift < 30 else left
        noisy = pixels + rng.normal(0, 0.05, pixels.shape)
        noisy[0] += 0.4 * drift, 0.3 * drift
        places = noisy[list(labels)]
        pose = estimator.estimate(CAMERA, labels, places, round(index / 30 * 1e9))
        if pose is not None:
            told.append(index)
            assert angle_between(pose.rotation, OPTICAL_FROM_BODY) < math.radians(2.0)
    assert 60 <= len(told) < 70
    if len(left) == 4:
        assert estimator.reason == 'the markers fit worse than before: one may be another light'


def test_where_the_noise_goes_on_it_is_the_usual_one():
    """As once an engine runs: four lights have no pose for two seconds, and then again."""
    rng = np.random.default_rng(9)
    pixels = seen(OPTICAL_FROM_BODY, np.array((0.0, 0.0, 100.0)))
    estimator, told = PoseEstimator(TANKER_747), []
    for index in range(400):
        noisy = pixels[:4] + rng.normal(0, 0.05 if index < 200 else 0.3, (4, 2))
        pose = estimator.estimate(CAMERA, range(4), noisy, round(index / 30 * 1e9))
        told.append(pose is not None)
    assert all(told[:200])
    assert sum(told[200:270]) < 30
    assert all(told[270:])
    assert estimator.noise == pytest.approx(0.3, rel=0.2)


def test_a_noise_that_rises_again_just_when_it_is_the_usual_one_is_so_in_turn():
    noise = _ResidualNoise()
    for deviation, frames in ((0.05, 100), (0.3, 60), (3.0, 200)):
        for _ in range(frames):
            noise.learn(2 * deviation**2, 2)
    assert not noise.has_risen
    assert noise.usual == pytest.approx(3.0, rel=0.05)


def test_three_lights_whose_solutions_meet_have_no_wrong_pose():
    scene = LightScene(roll=0.5, tilt=0.45, tilt_hz=0.2, barrel=-0.3, frames=80)
    flight = LightFlight(scene, 7)
    estimator = PoseEstimator(TANKER_747)
    rng = np.random.default_rng(0)
    told = []
    for stamp_ns, _, truth in itertools.islice(flight, 55, None):
        # Five lights at first, so that it is known which of three lights' solutions it is.
        labels = [0, 2, 4] if len(told) >= 10 else range(5)
        pixels = truth.pixels[list(labels)] + rng.normal(0.0, 0.02, (len(labels), 2))
        pose = estimator.estimate(flight.camera, labels, pixels, stamp_ns)
        told.append(pose is not None)
        if pose is not None:
            assert np.linalg.norm(deviations(pose, truth)[3:]) < math.radians(5.0)
    assert sum(told) >= 12
    assert not all(told)


def test_a_rig_of_three_lights_has_no_pose():
    """Nothing would show another light in the place of one of them, nor which solution is right."""
    three = parse_rig({'markers': {'a': [0, 4, 0], 'b': [1, -4, 0], 'c': [-1, 0, 3]}}, 'three')
    pixels = seen(OPTICAL_FROM_BODY, np.array((0.0, 0.0, 30.0)), three)
    estimator = PoseEstimator(three)
    assert estimator.estimate(CAMERA, range(3), pixels, 0) is None
    assert 'no other one confirms' in estimator.reason


def test_a_rig_of_single_precision_is_one():
    """As scanners and CAD programs give points."""
    points = np.array([(0, 1, 0.5), (0, -1, 0), (2, 0, 0)], np.float32)
    rig = MarkerRig('scan', tuple(zip('abc', points, strict=True)), points[0], points[0])
    assert rig.markers[0] == ('a', (0.0, 1.0, 0.5))


def test_a_rig_of_whole_metres_has_the_pose_of_one_of_floats():
    places = (0, 2, 0), (0, -2, 0), (-1, 0, 1), (-2, 1, -1)
    names = 'abcd'
    whole = MarkerRig(
        'whole', tuple(zip(names, map(np.array, places), strict=True)), [0] * 3, [0] * 3
    )
    floats = tuple(
        (name, tuple(map(float, place))) for name, place in zip(names, places, strict=True)
    )
    assert whole == MarkerRig('whole', floats, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert len({whole, whole}) == 1
    rvec = cv2.Rodrigues(OPTICAL_FROM_BODY)[0]
    pixels = CAMERA.project(whole.positions, rvec, (1.0, 2.0, 30.0))
    pose = PoseEstimator(whole).estimate(CAMERA, range(4), pixels, 0)
    assert pose is not None
    assert pose.translation == pytest.approx((1.0, 2.0, 30.0), abs=1e-4)

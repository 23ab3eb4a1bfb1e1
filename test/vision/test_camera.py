"""Calibrations: what OpenCV gives, lens models, and images that are binned, cut or rectified."""

import math

import cv2
import numpy as np
import pytest

from mvuav_ros.vision.camera import CalibrationError, CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY
from mvuav_ros.vision.markers.lights import Lens
from mvuav_ros.vision.pose import PoseEstimator
from mvuav_ros.vision.rig import TANKER_747
from mvuav_ros.vision.rig_examination import pose_error

K = np.array([[420.0, 0, 322], [0, 418, 239], [0, 0, 1]])
LENSES = {
    'plumb_bob': (-0.2, 0.05, 0.001, -0.0005, 0.0),
    'rational_polynomial': (0.1, 0.02, 0.0003, 0.0002, 0.001, 0.3, 0.05, 0.002),
    'equidistant': (0.05, -0.01, 0.002, -0.0005),
}


def camera_with(model):
    return CameraModel(640, 480, K, np.array(LENSES[model]).reshape(-1, 1), model)


@pytest.mark.parametrize('d', [np.zeros((1, 5)), np.zeros((5, 1)), np.zeros(4), (), None])
def test_what_opencv_gives_is_taken(d):
    camera = CameraModel(640, 480, k=K, d=d)
    camera.check(640, 480)
    assert camera.k == tuple(K.ravel())
    assert camera == CameraModel(640, 480, K.ravel().tolist(), d)
    assert hash(camera) is not None


@pytest.mark.parametrize(
    ('change', 'reason'),
    [
        ({'k': K[:2]}, '3 x 3 numbers, not 6'),
        ({'k': 'fx'}, 'no number'),
        ({'p': K}, '3 x 4 numbers, not 9'),
        ({'d': [[1.0], [2.0, 3.0]]}, 'no number'),
    ],
)
def test_what_is_no_matrix_is_refused_at_once(change, reason):
    with pytest.raises(CalibrationError, match=reason):
        CameraModel(**{'width': 640, 'height': 480, 'k': K, **change})


def test_images_of_a_camera_that_is_held_another_way_are_said_to_be_turned():
    camera = camera_with('plumb_bob')
    assert 'the images are 480 x 640 px (a quarter turn: turn' in camera.objection(480, 640)
    assert camera.objection(480, 480).endswith('the images are 480 x 480 px')


def test_a_calibration_without_numbers_is_the_same_when_it_comes_again():
    """Drivers send one with each image, and another one ends all tracks."""
    camera, again = (
        CameraModel(640, 480, *(tuple(float('nan') for _ in range(count)) for count in (9, 5)))
        for _ in range(2)
    )
    assert camera == again
    assert camera.binned(2, 2) == again.binned(2, 2)


@pytest.mark.parametrize(
    ('change', 'reason'),
    [
        ({'k': (0.0,) * 9}, 'not calibrated'),
        ({'k': K * ((1,), (0,), (1,))}, 'not calibrated'),
        ({'width': 320}, '320 x 480'),
        ({'width': -5}, 'region of interest'),
        ({'k': (math.nan,) * 9}, 'not finite'),
        ({'distortion_model': 'thin_prism'}, 'plumb_bob, rational_polynomial, equidistant'),
        ({'distortion_model': 'equidistant', 'd': (0.1,) * 5}, '0 or 4 distortion .*not 5'),
        ({'d': (0.1,) * 3}, 'not 3'),
        ({'is_rectified': True}, 'no projection matrix'),
        ({'k': K.T}, 'transposed'),
        ({'k': K + np.diag([4.0, 0.0], 1)}, 'without skew'),
    ],
)
def test_calibrations_that_are_refused(change, reason):
    camera = CameraModel(**{'width': 640, 'height': 480, 'k': K, **change})
    with pytest.raises(CalibrationError, match=reason):
        camera.check(640, 480)


@pytest.mark.parametrize('model', LENSES)
def test_undistort_undoes_project(model):
    widest = 80.0 if model == 'equidistant' else 40.0
    turns = np.radians(np.linspace(0.0, widest, 60))
    around = np.linspace(0.0, 40.0, 60)
    rays = np.stack([np.cos(around), np.sin(around)], axis=1) * np.tan(turns)[:, None]
    camera = camera_with(model)
    pixels = camera.project(np.column_stack((rays, np.ones(60))))
    assert np.abs(camera.undistort(pixels) - rays).max() < 2e-4 * np.tan(turns[-1])


def test_the_corners_of_a_wide_lens_go_there_and_back():
    # 80 degrees across, with strong barrel distortion.
    camera = CameraModel(640, 480, (458, 0, 320, 0, 458, 240, 0, 0, 1), (-0.32, 0.14, 0, 0, -0.033))
    corners = np.array([(0.0, 0.0), (639.0, 479.0), (0.0, 479.0), (20.0, 240.0)])
    rays = np.column_stack((camera.undistort(corners), np.ones(4)))
    assert camera.project(rays) == pytest.approx(corners, abs=1e-4)


def test_a_fisheye_projects_as_opencv_has_it():
    camera = camera_with('equidistant')
    points, turn, place = TANKER_747.positions, (0.1, 1.2, -1.1), (1.0, -2.0, 60.0)
    expected = cv2.fisheye.projectPoints(
        points[:, None], np.array(turn), np.array(place), K, np.array(LENSES['equidistant'])
    )[0]
    assert camera.project(points, turn, place) == pytest.approx(expected.reshape(-1, 2))
    # The angle off the axis, not its tangent, is what the image shows.
    wide = CameraModel(640, 480, K, (), 'equidistant').project([(1.0, 0.0, 1.0)])
    assert wide[0, 0] == pytest.approx(322 + 420 * math.pi / 4)


@pytest.mark.parametrize('model', LENSES)
def test_a_pose_is_found_through_every_lens(model):
    camera, rng = camera_with(model), np.random.default_rng(1)
    estimator = PoseEstimator(TANKER_747)
    rvec = cv2.Rodrigues(OPTICAL_FROM_BODY)[0].ravel()
    errors = []
    for index in range(40):
        # Off the axis, up to 60 degrees for the fisheye, where its model differs most.
        side = 2.0 if model == 'equidistant' else 0.4
        place = np.array((side * (index - 20) * 3.0, 5.0, 60.0))
        turn = rvec + rng.normal(0, 0.05, 3)
        pixels = camera.project(TANKER_747.positions, turn, place) + rng.normal(0, 0.05, (5, 2))
        pose = estimator.estimate(camera, range(5), pixels, round(index / 30 * 1e9))
        assert pose is not None, estimator.reason
        errors.append((pose.translation - place) / np.sqrt(np.diag(pose.covariance)[:3]))
        assert pose.translation == pytest.approx(place, abs=0.02 * np.linalg.norm(place))
    assert 0.4 < np.sqrt(np.mean(np.square(errors[10:]))) < 1.6


def test_the_markers_lens_goes_there_and_back_in_the_corners_of_a_fisheye():
    lens = Lens((640, 480), camera_with('equidistant'))
    corners = np.array([(0.0, 0.0), (639.0, 479.0), (0.0, 479.0), (322.0, 239.0)])
    assert lens.to_image(np.array(lens.straightened(corners))) == pytest.approx(corners, abs=1e-6)


def test_the_markers_lens_goes_there_and_back_in_a_frame_of_125_degrees():
    d = (0.7329, 0.08956, 0, 0, 0.00092, 1.06594, 0.24645, 0.00922)
    k = (293.4, 0, 319.5, 0, 293.4, 239.5, 0, 0, 1)
    lens = Lens((640, 480), CameraModel(640, 480, k, d, 'rational_polynomial'))
    sides = np.array([(0.0, 240.0), (639.0, 479.0), (20.0, 100.0)])
    assert lens.to_image(np.array(lens.straightened(sides))) == pytest.approx(sides, abs=1e-3)


@pytest.mark.parametrize(
    ('model', 'd'),
    [
        ('plumb_bob', (-0.4, 0.2, 0, 0, -0.05)),
        ('plumb_bob', (-0.3, 0, 0, 0)),
        ('rational_polynomial', (-0.2, -0.1, 0, 0, 0, 0.1, 0.05, 0.01)),
        ('equidistant', (-0.1, -0.05, 0.02, -0.01)),
    ],
)
def test_a_lens_is_followed_until_it_turns_back(model, d):
    camera = CameraModel(640, 480, K, d, model)
    x = camera.widest * np.array((0.9, 0.99, 1.01, 1.1))
    places = np.column_stack((x, np.zeros(4), np.ones(4)))
    before, at, after, beyond = camera.project(places)[:, 0]
    assert before < at and after > beyond
    assert camera.shows(places).tolist() == [True, True, False, False]
    # What is predicted farther out stays at the last place that there is.
    lens = Lens((640, 480), camera)
    far = lens.centre + lens.focal * np.array([(3.0, 0.0), (9.0, 0.0)])
    assert lens.to_image(far) == pytest.approx(camera.project([(camera.widest, 0, 1)] * 2), abs=0.1)


def test_lenses_that_do_not_turn_back_show_what_is_ahead():
    for d in ((), (-0.2, 0.05, 0, 0)):
        places = np.array([(5.0, 0.0, 1.0), (0.0, 0.0, -1.0), (3.0, 4.0, 0.0)])
        assert CameraModel(640, 480, K, d).shows(places).tolist() == [True, False, False]


def test_a_rigs_errors_are_predicted_through_a_fisheye():
    # On the axis a fisheye without coefficients is a pinhole camera.
    plain = pose_error(TANKER_747, CameraModel(640, 480, K), 2000.0, 0.1)
    fisheye = pose_error(TANKER_747, CameraModel(640, 480, K, (), 'equidistant'), 2000.0, 0.1)
    assert fisheye.along == pytest.approx(plain.along, rel=0.01)


@pytest.mark.parametrize('model', LENSES)
def test_binned_and_cut_images_see_the_same_rays(model):
    camera = camera_with(model)
    rays = [(0.1, -0.05, 1.0), (-0.2, 0.15, 1.0)]
    whole = camera.project(rays)
    cut = camera.cropped(100, 60, 400, 320)
    assert cut.project(rays) == pytest.approx(whole - (100, 60))
    binned = cut.binned(4, 2)
    binned.check(100, 160)
    # Pixels 0 to 3 become pixel 0, whose centre was at 1.5.
    assert binned.project(rays) == pytest.approx((whole - (101.5, 60.5)) / (4, 2))


def test_a_part_that_reaches_beyond_the_images_is_no_calibration_of_it():
    # A driver that gives its region's size and matrix as those of whole images, and the region.
    driver = camera_with('plumb_bob').cropped(100, 60, 400, 320)
    with pytest.raises(CalibrationError, match='300 x 260 px, the images are 400 x 320 px'):
        driver.cropped(100, 60, 400, 320).check(400, 320)


def test_binning_agrees_with_a_picture_whose_pixels_are_averaged():
    camera = CameraModel(640, 480, K)
    place = camera.project([(0.123, -0.045, 1.0)])[0]
    rows, columns = np.mgrid[:480, :640]
    spot = np.exp(-((columns - place[0]) ** 2 + (rows - place[1]) ** 2) / 2 / 4.0**2)
    small = cv2.resize(spot, (320, 240), interpolation=cv2.INTER_AREA)
    small_rows, small_columns = np.mgrid[:240, :320]
    seen = np.array(((small * small_columns).sum(), (small * small_rows).sum())) / small.sum()
    assert camera.binned(2, 2).project([(0.123, -0.045, 1.0)])[0] == pytest.approx(seen, abs=1e-3)


@pytest.mark.parametrize('model', ['plumb_bob', 'equidistant'])
def test_rectified_images_are_seen_through_p_alone(model):
    raw = camera_with(model)
    p = (300.0, 0, 310, 0, 0, 305, 230, 0, 0, 0, 1, 0)
    camera = CameraModel(640, 480, raw.k, raw.d, model, p=p).rectified()
    camera.check(640, 480)
    assert camera.project([(0.5, -0.2, 1.0)])[0] == pytest.approx((460.0, 169.0))
    assert camera.undistort([(460.0, 169.0)])[0] == pytest.approx((0.5, -0.2))
    assert camera.binned(2, 2).matrix[0, 0] == 150.0


def test_a_calibration_cannot_be_changed_from_outside():
    """It is the key of what was worked out of it."""
    camera = CameraModel(640, 480, K)
    for array in (camera.matrix, camera.distortion):
        with pytest.raises(ValueError, match='read-only'):
            array[:] = 1.0


def test_what_no_float_can_hold_is_no_number_of_a_calibration():
    with pytest.raises(CalibrationError, match='no number'):
        CameraModel(640, 480, [10**400] * 9)

"""The pipeline as a whole: starting, following, letting go, and odd frames."""

import math

import cv2
import numpy as np
import pytest

from mvuav_ros.cli.bench.cases import approach_cases
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.simulation.runway_flight import RunwayFlight
from mvuav_ros.simulation.settings import RunwaySettings
from mvuav_ros.vision.approach.approach_detector import ApproachDetector
from mvuav_ros.vision.approach.attitude import HorizonLine
from mvuav_ros.vision.approach.overlay import draw_approach
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import Attitude
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.runway.detector import RunwayDetector
from mvuav_ros.vision.runway.results import LineRole

APPROACH = RunwayDetectorParameters(mode='approach')
FRAMES = 40


@pytest.fixture(scope='module')
def images():
    flight = RunwayFlight(RunwaySettings(frames=FRAMES))
    return [flight.frame(index).image.pixels for index in range(FRAMES)]


def run(pipeline, images, first=0):
    return [pipeline.process(image, index) for index, image in enumerate(images, first)]


def test_it_starts_by_itself_within_a_second_and_stays(images):
    seen = [result.corners is not None for result in run(ApproachDetector(APPROACH), images)]
    first = seen.index(True)
    assert first < 25
    assert all(seen[first:])


def test_lines_pass_through_the_corners_and_meet_in_the_vanishing_point(images):
    result = run(ApproachDetector(APPROACH), images)[-1]
    near_left, near_right, far_right, far_left = result.corners
    assert near_left[0] < near_right[0] and far_left[0] < far_right[0]
    assert near_left[1] > far_left[1]
    ends = {
        LineRole.LEFT_EDGE: (near_left, far_left, result.vanishing_point),
        LineRole.RIGHT_EDGE: (near_right, far_right, result.vanishing_point),
        LineRole.FAR_END: (far_left, far_right),
        LineRole.NEAR_END: (near_left, near_right),
    }
    for role, points in ends.items():
        line = result.lines[role - 1]
        assert line.role is role
        for x, y in points:
            distance = x * math.cos(line.theta_raw) + y * math.sin(line.theta_raw) - line.rho_raw
            assert abs(distance) < 1e-6


def test_a_grey_camera_in_three_channels_is_as_one_in_one(images):
    grey = [cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in images]
    one = run(ApproachDetector(APPROACH), grey)
    three = run(ApproachDetector(APPROACH), [cv2.merge([image] * 3) for image in grey])
    assert [r.corners for r in three] == [r.corners for r in one]
    assert [r.confidence for r in three] == [r.confidence for r in one]
    assert one[-1].corners is not None


def test_a_runway_that_disappears_is_let_go_within_half_a_second(images):
    pipeline = ApproachDetector(APPROACH)
    run(pipeline, images)
    sky = np.full_like(images[0], 0)
    sky[:] = images[0][5, 5]
    after = run(pipeline, [sky] * 20, len(images))
    assert after[-1].corners is None
    assert after[-1].status
    assert np.isnan([line.rho for line in after[-1].lines]).all()
    confidences = [result.confidence for result in after]
    assert confidences == sorted(confidences, reverse=True)


def test_nothing_is_reported_below_the_confidence_asked_for(images):
    every = ApproachDetector(RunwayDetectorParameters(mode='approach', min_confidence=0.0))
    shown = run(every, images[:3])[-1]
    assert 0.0 < shown.confidence < 1.0
    strict = ApproachDetector(RunwayDetectorParameters(mode='approach', min_confidence=1.0))
    hidden = run(strict, images[:3])[-1]
    assert hidden.corners is None
    assert hidden.confidence == shown.confidence
    assert f'{shown.confidence:.2f}' in hidden.status
    assert np.isnan([line.rho for line in hidden.lines]).all()


def test_one_image_alone_is_enough(images):
    assert run(ApproachDetector(APPROACH), images[:1])[0].corners is not None


@pytest.mark.parametrize(
    'change',
    [
        pytest.param(lambda image: cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), id='grey'),
        pytest.param(lambda image: image.astype(np.uint16) * 256, id='16 bits'),
        pytest.param(lambda image: image.astype(np.uint16) * 16, id='12 of 16 bits'),
    ],
)
def test_grey_and_more_bits_show_the_same_runway(images, change):
    anything = RunwayDetectorParameters(mode='approach', min_confidence=0.0)
    colour = run(ApproachDetector(anything), images)[-1]
    other = run(ApproachDetector(anything), [change(image) for image in images])[-1]
    assert np.allclose(colour.corners[:2], other.corners[:2], atol=4.0)


@pytest.mark.parametrize('bits', [10, 12, 16])
def test_the_same_picture_in_more_bits_is_the_same(images, bits):
    """Of a camera whose brightest pixel shows how many it has, as an array and as an image."""
    anything = RunwayDetectorParameters(mode='approach', min_confidence=0.0)
    images = [image.copy() for image in images]
    images[0][0, 0] = 255
    deep = [image.astype(np.uint16) << (bits - 8) for image in images]
    one = run(ApproachDetector(anything), images)
    for given in (deep, [Image(image, 'bgr16') for image in deep]):
        for left, right in zip(one, run(ApproachDetector(anything), given), strict=True):
            assert left.corners == right.corners and left.confidence == right.confidence
    reds = [Image(image[..., ::-1].copy(), 'rgb16') for image in deep]
    assert run(ApproachDetector(anything), reds)[-1].corners == one[-1].corners


def test_noise_and_plain_land_are_no_runway():
    rng = np.random.default_rng(1)
    noise = [rng.integers(0, 255, (240, 320, 3), np.uint8) for _ in range(3)]
    plain = np.full((240, 320, 3), (200, 180, 160), np.uint8)
    plain[90:] = (60, 110, 90)
    for images in (noise, [plain] * 3):
        assert all(result.corners is None for result in run(ApproachDetector(APPROACH), images))


def test_attitude_is_used_and_its_loss_is_said(images):
    """A horizon far from the runway's vanishing point forbids it; without one it is found."""
    pipeline = ApproachDetector(APPROACH)
    found = pipeline.process(images[0], 0)
    assert pipeline.attitude_problem == ''
    off = HorizonLine(found.vanishing_point[1] + 150.0, 0.0)
    pipeline.reset()
    assert pipeline.process(images[0], 0, off).corners is None
    pipeline.reset()
    right = HorizonLine(found.vanishing_point[1], 0.0)
    assert pipeline.process(images[0], 0, right).corners is not None
    assert pipeline.process(images[1], 1).corners is not None
    assert 'no attitude' in pipeline.attitude_problem


def test_attitude_needs_a_calibrated_camera(images):
    pipeline = ApproachDetector(APPROACH)
    pipeline.process(images[0], 0, Attitude.from_roll_pitch(0.0, 0.0))
    assert 'camera_info' in pipeline.attitude_problem
    ignoring = ApproachDetector(RunwayDetectorParameters(mode='approach', horizon_source='image'))
    ignoring.process(images[0], 0, Attitude.from_roll_pitch(0.0, 0.0))
    assert ignoring.attitude_problem == ''


def test_results_repeat(images):
    first, second = (run(ApproachDetector(APPROACH), images)[-1] for _ in range(2))
    assert first.corners == second.corners
    pipeline = ApproachDetector(APPROACH)
    run(pipeline, images)
    pipeline.reset()
    assert run(pipeline, images)[-1].corners == first.corners


def test_the_frame_is_not_changed(images):
    before = images[3].copy()
    ApproachDetector(APPROACH).process(images[3], 0)
    assert np.array_equal(images[3], before)


@pytest.mark.parametrize(
    'shape', [(0, 0), (1, 1), (3, 500), (47, 300, 3), (48, 48), (60, 2000, 3), (700, 50, 3)]
)
@pytest.mark.parametrize('dtype', [np.uint8, np.uint16])
@pytest.mark.parametrize('target', ['runway', 'road', 'pipeline'])
def test_any_size_and_format_gives_a_result(shape, dtype, target):
    rng = np.random.default_rng(4)
    pipeline = ApproachDetector(RunwayDetectorParameters(mode='approach', target=target))
    for index in range(4):
        image = rng.integers(0, np.iinfo(dtype).max, shape, dtype)
        result = pipeline.process(image, index)
        assert len(result.lines) == 5
        assert draw_approach(result).ndim == 3


def test_a_frame_of_another_size_starts_afresh(images):
    pipeline = ApproachDetector(APPROACH)
    run(pipeline, images)
    small = cv2.resize(images[-1], (320, 240), interpolation=cv2.INTER_AREA)
    again = run(pipeline, [small] * 30)
    assert again[-1].corners is not None


def test_large_frames_give_the_same_runway_in_their_own_pixels(images):
    large = [cv2.resize(p, (1280, 960), interpolation=cv2.INTER_LINEAR) for p in images]
    left, right = RunwayFlight(RunwaySettings(frames=FRAMES)).frame(FRAMES - 1).truth.lines[:2]
    truth = ((left.x1, left.y1), (right.x1, right.y1), (right.x2, right.y2), (left.x2, left.y2))
    small = run(ApproachDetector(APPROACH), images)[-1].corners
    big = run(ApproachDetector(APPROACH), large)[-1].corners
    halved = [((x + 0.5) / 2 - 0.5, (y + 0.5) / 2 - 0.5) for x, y in big]
    for corner, other, (x, y) in zip(small, halved, truth, strict=True):
        for found in (corner, other):
            assert found[0] == pytest.approx(x, abs=2.0)
            # Ends are whole rows of the working image, of which a px is two of these.
            assert found[1] == pytest.approx(y, abs=4.0)


def test_a_pipeline_is_followed():
    """A pale line three pixels wide at the foot, from a drone beside it."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:240, :320].astype(float)
    land = np.where((y > 80)[:, :, None], (60.0, 120.0, 100.0), (230.0, 210.0, 190.0))
    pipeline = ApproachDetector(RunwayDetectorParameters(mode='approach', target='pipeline'))
    result = None
    for index in range(40):
        depth = y - 80
        middle = 150 + 0.1 * index + 0.25 * depth
        share = np.clip(0.05 * depth - np.abs(x - middle) + 0.5, 0, 1) * (depth > 5)
        image = land * (1 - share[:, :, None]) + 170 * share[:, :, None]
        noisy = np.clip(image + rng.normal(0, 3, image.shape), 0, 255).astype(np.uint8)
        result = pipeline.process(noisy, index)
    assert result.corners is not None
    left, right = result.lines[:2]
    for line, aside in ((left, -0.05), (right, 0.05)):
        column = (line.rho - 230 * math.sin(line.theta)) / math.cos(line.theta)
        assert column == pytest.approx(150 + 3.9 + (0.25 + aside) * 150, abs=2.5)
    assert not result.lines[LineRole.NEAR_END - 1].found


def test_flags_are_raised_line_by_line(images):
    """With thresholds of nothing every move is a jump; the line is reported as it is."""
    strict = RunwayDetectorParameters(
        mode='approach', rho_error_threshold=0.0, theta_error_threshold_deg=0.0
    )
    pipeline = ApproachDetector(strict)
    results = run(pipeline, images)
    left = [result.lines[0] for result in results if result.lines[0].found]
    assert left[-1].rho_flag and left[-1].corrected
    assert left[-1].rho == left[-1].rho_raw != left[-2].rho
    assert sum(line.corrected for line in left) > 5
    calm = [line for result in run(ApproachDetector(APPROACH), images) for line in result.lines]
    assert sum(line.found for line in calm if line.role == LineRole.LEFT_EDGE) > 10
    assert not any(line.corrected for line in calm)


def test_bench_cases_find_the_runway():
    cases = approach_cases()
    assert [case.limit_ms for case in cases] == [5.0, pytest.approx(1000 / 60)]
    for case in cases:
        results = [case.run() for _ in range(40)]
        assert results[-1].corners is not None


@pytest.mark.parametrize('frames', [3, 9])
def test_a_shape_that_became_impossible_is_let_go(images, frames):
    """Young tracks are weighed in every frame, older ones not; neither may report NaN."""
    pipeline = ApproachDetector(APPROACH)
    run(pipeline, images[:frames])
    tracker = pipeline._finder.tracker
    broken = tracker.best
    broken.shape.state[:] = math.nan
    result = pipeline.process(images[frames], frames)
    assert broken not in tracker.tracks
    assert result.corners is None or np.isfinite(result.corners).all()


@pytest.mark.parametrize('target', ['runway', 'pipeline'])
@pytest.mark.parametrize(
    'horizon', [(math.nan, 0.0), (0.0, math.nan), (math.inf, 0.0), (90.0, math.inf), (90.0, 3.2)]
)
def test_a_horizon_that_is_none(images, target, horizon):
    detector = ApproachDetector(RunwayDetectorParameters(mode='approach', target=target))
    for index, image in enumerate(images[:3]):
        detector.process(image, index, HorizonLine(*horizon))
        assert detector.attitude_problem == "the horizon given is none: the horizon is the image's"


@pytest.mark.parametrize('width', [1283, 1366, 1919])
def test_a_given_horizon_is_where_it_is_on_a_frame_of_any_width(width):
    """The working image leaves out the last columns that make no whole pixel of it."""
    land = np.random.default_rng(0).integers(0, 255, (720, width), np.uint8)
    slope = math.radians(20.0)
    left, right = ApproachDetector(APPROACH).process(land, 0, HorizonLine(300.0, slope)).horizon
    half = 0.5 * (width - 1) * math.tan(slope)
    assert left == pytest.approx((0.0, 300.0 - half), abs=0.01)
    assert right == pytest.approx((width - 1.0, 300.0 + half), abs=0.01)


@pytest.mark.parametrize('kind', [ApproachDetector, RunwayDetector])
def test_a_call_that_is_refused_forgets_nothing(images, kind):
    detector, again = kind(), kind()
    for index, image in enumerate(images[:4]):
        detector.process(image, index)
        again.process(image, index)
    with pytest.raises(TypeError):
        detector.process(np.zeros((100, 100), np.uint8), 1.5)
    lines, others = (each.process(images[4], 4).lines for each in (detector, again))
    np.testing.assert_equal(lines, others)


def test_an_upright_horizon_crosses_neither_side_of_the_frame(images):
    """An attitude that a sensor gives in the optical axes shows it so."""
    upright = HorizonLine(240.0, math.nextafter(0.5 * math.pi, 0.0))
    result = ApproachDetector(APPROACH).process(images[0], 0, upright)
    assert result.horizon is None
    assert draw_approach(result).shape == images[0].shape


def test_edges_that_do_not_meet_at_the_attitudes_horizon_are_no_runway(images):
    """What was followed without attitude may be half a runway and paint before it."""
    detector = ApproachDetector(APPROACH)
    found = run(detector, images)[-1]
    assert found.corners is not None and found.vanishing_point is not None
    _, y = found.vanishing_point
    px = images[-1].shape[1] / 320
    for off, is_reported in ((0.0, True), (18.0, True), (-34.0, False), (0.0, True)):
        again = detector.process(images[-1], 10**9, HorizonLine(y + off * px, 0.0))
        assert (again.corners is not None) == is_reported, again.status
        assert ('do not meet' in again.status) != is_reported


def test_what_is_too_short_for_a_runway_is_not_reported(images):
    """The same picture through a wider lens shows a strip of fewer widths from end to end."""
    detector = ApproachDetector(APPROACH)
    height, width = images[0].shape[:2]
    for index, (field, is_reported) in enumerate([(1.0, True), (16.0, False), (1.0, True)]):
        focal = width / field
        detector.set_camera(
            CameraModel(width, height, (focal, 0, width / 2, 0, focal, height / 2, 0, 0, 1))
        )
        result = detector.process(images[index], index)
        assert (result.corners is not None) == is_reported, result.status
        assert ('too short' in result.status) != is_reported

"""What is no view of a runway is not reported with confidence, and the status says why."""

import math

import cv2
import numpy as np
import pytest
from support.drawn_ground import drawn_strip

from mvuav_ros.messages.images import Frame
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.processing.runway_processor import RunwayDetectorProcessor
from mvuav_ros.vision.approach.approach_detector import ApproachDetector
from mvuav_ros.vision.approach.attitude import HorizonLine
from mvuav_ros.vision.approach.ground_motion import Overlaid
from mvuav_ros.vision.approach.tuning import GUIDANCE
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import Attitude
from mvuav_ros.vision.image import Image

RUNWAY = {'height': 60, 'width': 30, 'speed': 2, 'ends': (400, 1500)}
GRASS = {**RUNWAY, 'ends': (1e8, 1e9)}
HORIZON_ROW = 100
FRAMES = 40
STEP_NS = 33_000_000
CONFIDENT = 0.5


def from_the_air(frames=FRAMES, **scene):
    return [drawn_strip(index, **(scene or RUNWAY)) for index in range(frames)]


@pytest.fixture(scope='module')
def flight():
    return from_the_air()


def results(images, attitude=None):
    detector = ApproachDetector(RunwayDetectorParameters(mode='approach'))
    detector.set_camera(CameraModel(320, 240, (300, 0, 160, 0, 300, 120, 0, 0, 1)))
    for index, image in enumerate(images):
        yield detector.process(image, index * STEP_NS, attitude), detector.attitude_problem


def confident(images, attitude=None):
    """How many frames are reported with confidence, and the last one's status and problem."""
    found = list(results(images, attitude))
    count = sum(result.confidence >= CONFIDENT for result, _ in found)
    return count, found[-1][0].status, found[-1][1]


def test_the_drawn_runway_is_reported(flight):
    """Otherwise none of the other tests here says anything."""
    assert confident(flight)[0] == FRAMES


@pytest.mark.parametrize(
    ('height', 'width', 'aside'),
    [(1.0, 8, 0), (1.5, 10, 0), (2.0, 15, 0), (2.0, 8, 1.5), (1.2, 15, 3), (2.0, 12, -4)],
)
def test_a_road_seen_from_a_car_is_no_runway(height, width, aside):
    road = from_the_air(height=height, width=width, aside=aside)
    assert confident(road)[0] == 0


@pytest.mark.parametrize('level', [0, 255])
def test_a_black_or_white_picture(level):
    count, status, _ = confident([np.full((240, 320, 3), level, np.uint8)] * 3)
    assert count == 0
    assert 'is all alike' in status


@pytest.mark.parametrize(('level', 'share'), [(150, 0.15), (190, 0.2), (0, 0.2)])
def test_a_runway_in_fog_or_underexposed_is_found(flight, level, share):
    """So little of the grey levels is used that most steps are smaller than noise usually is."""
    faint = [np.rint(level + share * (image - float(level))).astype(np.uint8) for image in flight]
    assert confident(faint)[0] > 0.9 * FRAMES


def test_noise_hides_a_runway(flight):
    rng = np.random.default_rng(0)
    noisy = [np.clip(image + rng.normal(0, 60, image.shape), 0, 255) for image in flight]
    count, status, _ = confident([image.astype(np.uint8) for image in noisy])
    assert count == 0
    assert status.startswith('no runway')


@pytest.mark.parametrize(
    ('spoil', 'reason'),
    [
        (lambda image, _: np.zeros_like(image), 'is all alike'),
        (lambda image, _: np.full_like(image, 255), 'is all alike'),
        (
            lambda image, rng: rng.integers(0, 256, image.shape).astype(np.uint8),
            'nothing of what the last one did',
        ),
    ],
    ids=['black', 'white', 'noise'],
)
def test_what_was_followed_is_not_reported_of_a_frame_that_shows_nothing(flight, spoil, reason):
    """Not even of the first one; and it is reported again once it is seen."""
    rng = np.random.default_rng(2)
    spoilt = [spoil(image, rng) for image in flight[20:24]]
    found = [result for result, _ in results(flight[:20] + spoilt + flight[24:])]
    assert [result.confidence >= CONFIDENT for result in found[19:24]] == [True] + [False] * 4
    assert reason in found[20].status
    assert found[-1].confidence >= CONFIDENT
    assert not found[-1].status


def test_a_camera_may_sway(flight):
    """By up to 11 px from frame to frame, as an aircraft without a gimbal does."""
    detector = ApproachDetector(RunwayDetectorParameters(mode='approach'))
    for index, (image, (still, _)) in enumerate(zip(flight, results(flight), strict=True)):
        right, down = 25.0 * math.sin(0.4 * index), 10.0 * math.sin(0.55 * index)
        matrix = np.array([[1.0, 0.0, right], [0.0, 1.0, down]])
        swaying = cv2.warpAffine(image, matrix, (320, 240), borderMode=cv2.BORDER_REPLICATE)
        result = detector.process(swaying, index)
        assert result.confidence >= CONFIDENT
        assert result.corners is not None and still.corners is not None
        for (x, _), (at_x, _) in zip(result.corners[:2], still.corners[:2], strict=True):
            assert x - right == pytest.approx(at_x, abs=6.0)


def no_signal(image, _):
    """What a receiver shows while nothing comes."""
    blue = np.full_like(image, (180, 0, 0))
    return cv2.putText(blue, 'NO SIGNAL', (80, 120), cv2.FONT_HERSHEY_PLAIN, 1, (255,) * 3, 2)


@pytest.mark.parametrize(
    'spoil',
    [
        lambda image, _: np.zeros_like(image),
        lambda image, rng: rng.integers(0, 256, image.shape).astype(np.uint8),
        no_signal,
    ],
    ids=['black', 'noise', 'no signal'],
)
def test_frames_that_show_nothing_cost_no_others(flight, spoil):
    """Every sixth shows none of the runway, as the tracks are weighed in every sixth."""
    rng = np.random.default_rng(2)
    for first in range(6):
        is_spoilt = [index >= 6 and index % 6 == first for index in range(FRAMES)]
        images = [
            spoil(image, rng) if spoils else image
            for image, spoils in zip(flight, is_spoilt, strict=True)
        ]
        found = [result.confidence >= CONFIDENT for result, _ in results(images)]
        assert found == [not spoils for spoils in is_spoilt]


@pytest.mark.parametrize('attitude', [None, HorizonLine(HORIZON_ROW, 0.0)], ids=['none', 'given'])
def test_black_frames_before_a_runway_was_found_cost_no_others(flight, attitude):
    """As of a camera that starts: the first picture that shows anything is searched as a whole."""
    undisturbed = [result.confidence for result, _ in results(flight[:8], attitude)]
    black = np.zeros_like(flight[0])
    late = [result.confidence for result, _ in results([black] * 3 + flight[:8], attitude)]
    assert late == [0.0] * 3 + undisturbed
    between = [each for image in flight[:8] for each in (black, image)]
    found = [result.confidence >= CONFIDENT for result, _ in results(between, attitude)]
    assert found == [False, True] * 8


def test_a_torn_picture_is_reported_where_the_runway_is(flight):
    """The rows below somewhere come from the frame before, moved sideways."""
    torn = [flight[0]]
    for index in range(1, FRAMES):
        image, cut = flight[index].copy(), 100 + index * 37 % 100
        image[cut:] = np.roll(flight[index - 1][cut:], index * 53 % 200 + 20, axis=1)
        torn.append(image)
    for (result, _), (true, _) in zip(results(torn), results(flight), strict=True):
        if result.confidence >= CONFIDENT and result.corners is not None:
            assert result.vanishing_point == pytest.approx(true.vanishing_point, abs=15)


def test_a_frozen_picture_is_doubted_after_two_seconds(flight):
    found = [result for result, _ in results(flight[:10] + [flight[9]] * 60)]
    assert found[30].confidence >= CONFIDENT
    assert found[-1].confidence == 0
    assert 'has not changed' in found[-1].status


def test_a_stamp_that_jumps_back_is_refused_and_nothing_is_lost(flight):
    detector = ApproachDetector(RunwayDetectorParameters(mode='approach'))
    undisturbed = [result.confidence for result, _ in results(flight)]
    for index, image in enumerate(flight):
        if index == FRAMES // 2:
            with pytest.raises(ValueError, match='stamp 3 ns is before 627000000 ns'):
                detector.process(image, 3)
        assert detector.process(image, index * STEP_NS).confidence == undisturbed[index]


def test_a_recording_that_begins_again_is_searched_afresh(flight):
    """What was followed until then says nothing of the frames before it."""
    processor = RunwayDetectorProcessor(RunwayDetectorParameters(mode='approach'))

    def status(image, index):
        list(processor.process(Frame(index * STEP_NS, 'camera', Image(image, 'bgr8'))))
        return processor.status

    grass = drawn_strip(0, **GRASS)
    first = status(grass, 0)
    assert first.startswith('no runway')
    assert [status(image, index) for index, image in enumerate(flight, 1)][-1] == ''
    assert status(grass, 0) == first
    assert processor.resets == 1


@pytest.mark.parametrize(
    'attitude',
    [
        pytest.param(Attitude.from_roll_pitch(math.pi, 0.0), id='rolled'),
        pytest.param(Attitude.from_roll_pitch(0.0, math.pi), id='pitched'),
    ],
)
def test_an_attitude_that_is_wrong_by_180_degrees_is_no_attitude(flight, attitude):
    count, status, problem = confident(flight, attitude)
    assert count == 0
    assert 'upside down' in status
    assert 'camera_mount_rpy_deg' in problem
    processor = RunwayDetectorProcessor(RunwayDetectorParameters(mode='approach'))
    camera = CameraModel(320, 240, (300, 0, 160, 0, 300, 120, 0, 0, 1))
    list(processor.process(Frame(0, 'camera', Image(flight[0], 'bgr8'), camera, attitude)))
    assert processor.status.count('upside down') == 1
    assert 'see camera_mount_rpy_deg' in processor.status


def test_a_right_attitude_is_one(flight):
    right = Attitude.from_roll_pitch(0.0, math.atan((HORIZON_ROW - 120) / 300) * -1)
    assert confident(flight, right)[0] == FRAMES


def test_nothing_above_the_horizon_is_reported(flight):
    """A runway in the sky: the view upside down, with the horizon as attitude would give it."""
    sky = [np.ascontiguousarray(image[::-1]) for image in flight]
    assert confident(sky, HorizonLine(239.0 - HORIZON_ROW, 0.0))[0] == 0


def test_a_deviation_that_is_no_number_is_that_of_no_horizon(flight):
    parameters = RunwayDetectorParameters(mode='approach', runway_width=30.0)
    detector = ApproachDetector(parameters)
    detector.set_camera(CameraModel(320, 240, (300, 0, 160, 0, 300, 120, 0, 0, 1)))
    guidance = detector.process(flight[0], 0, HorizonLine(HORIZON_ROW, 0.0, math.nan)).guidance
    assert guidance is not None and guidance.known
    assert guidance.covariance[3, 3] == pytest.approx(GUIDANCE.bank_sigma**2)


@pytest.mark.parametrize('row', [-1e300, -1e21, 1e300])
def test_a_horizon_may_be_anywhere(flight, row):
    """As of a camera that is rolled by a quarter turn, to within rounding."""
    assert confident(flight[:2], HorizonLine(row, 0.0)) == (0, 'no runway', '')


def test_a_track_above_the_horizon_is_vetoed(flight):
    """Even one that was reported before the horizon was known."""
    detector = ApproachDetector(RunwayDetectorParameters(mode='approach', min_confidence=0.0))
    for index, image in enumerate(flight):
        before = detector.process(image, index)
    assert before.corners is not None
    lowest = max(y for _, y in before.corners)
    after = detector.process(flight[-1], FRAMES, HorizonLine(lowest + 6.0, 0.0))
    assert after.corners is None
    assert after.confidence == 0
    assert 'above the horizon' in after.status


def painted(index, ground):
    """The first frame's runway, pasted where it was onto ground that moves."""
    mask = np.zeros((240, 320), np.uint8)
    cv2.fillConvexPoly(mask, np.array([(156, 103), (164, 103), (182, 160), (138, 160)]), 1)
    return np.where(mask[:, :, None] > 0, drawn_strip(0, **RUNWAY), ground[index])


def test_a_strip_painted_on_the_picture_is_no_runway(monkeypatch):
    """It stands still while the ground moves."""
    ground = from_the_air(80, **{**GRASS, 'height': 20})
    images = [painted(index, ground) for index in range(80)]
    last = [result.confidence for result, _ in results(images)][50:]
    assert max(last) < CONFIDENT
    monkeypatch.setattr(Overlaid, 'take', lambda *_: None)
    believed = [result.confidence for result, _ in results(images)][50:]
    assert max(believed) > max(last)


def test_a_grey_camera_may_send_three_channels(flight):
    """Its encoding changes no result, of a picture that is a part of a larger one either."""
    gray = [cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in flight[:8]]
    part = [np.stack([image] * 3, axis=2).repeat(2, axis=1)[:, ::2] for image in gray]
    for (one, _), (other, _) in zip(results(gray), results(part), strict=True):
        assert one.corners == other.corners
        assert one.confidence == other.confidence
        assert np.array_equal(one.horizon, other.horizon)
    assert one.confidence > 0.0

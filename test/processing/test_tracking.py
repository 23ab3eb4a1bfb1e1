"""The library does what it is told, or says why not."""

from __future__ import annotations

import math
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from support.places import ROOT

import mvuav_ros
from mvuav_ros import (
    ApproachDetector,
    CameraModel,
    Image,
    MarkerRig,
    MarkerTracker,
    PoseEstimator,
    RunwayDetector,
    draw,
    load_calibration,
    load_parameters,
    open_source,
    track,
)
from mvuav_ros.messages.images import BadFrame, Frame
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.parameters.video_source import VideoSourceParameters
from mvuav_ros.simulation.light_drawing import Light, add_lights
from mvuav_ros.sources.opening import make_flight
from mvuav_ros.sources.source import FrameSource, SourceError
from mvuav_ros.vision.camera import CalibrationError
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY
from mvuav_ros.vision.image import ImageError
from mvuav_ros.vision.rig import TANKER_747, RigError

RIG = {'nose': [0.3, 0, 0], 'left': [0, 0.5, 0], 'right': [0.1, -0.6, 0], 'top': [0, 0, 0.4]}
CORNERS = {'a': (0, 1, 1), 'b': (0, -1, 1), 'c': (0, -1, -1), 'd': (0, 1, -1)}
GRAY = np.zeros((120, 160), np.uint8)
TANKER_CAMERA = CameraModel(640, 480, k=(600, 0, 319.5, 0, 600, 239.5, 0, 0, 1))


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    file = tmp_path / 'rig4.yaml'
    file.write_text(yaml.safe_dump({'name': 'four', 'markers': RIG}, sort_keys=False))
    return file


def test_the_rig_of_the_parameters_is_tracked(rig_file: Path, tmp_path: Path) -> None:
    tracker = MarkerTracker(MarkerTrackerParameters(layout=str(rig_file)))
    assert tracker.rig.names == tuple(RIG)
    assert len(tracker.process(GRAY, 0).markers) == 4
    file = tmp_path / 'parameters.yaml'
    file.write_text(f"marker_tracker: {{ros__parameters: {{layout: '{rig_file}'}}}}")
    assert MarkerTracker(load_parameters(file, 'marker_tracker')).rig.names == tuple(RIG)
    with pytest.raises(ParameterError, match=r'/nonexistent\.yaml: No such file'):
        MarkerTracker(MarkerTrackerParameters(layout='/nonexistent.yaml'))
    with pytest.raises(ParameterError, match='make another'):
        tracker.configure(MarkerTrackerParameters())


def test_a_rig_that_cannot_be_told_apart_is_refused() -> None:
    square = MarkerRig('square', tuple(CORNERS.items()), (0, 0, 0), (0, 0, 0))
    with pytest.raises(ParameterError, match=r'square: the shape is symmetric.*allow_ambiguous'):
        MarkerTracker(rig=square)
    allowed = MarkerTracker(MarkerTrackerParameters(allow_ambiguous=True), square)
    assert 'symmetric' in allowed.doubts[0]


def test_a_rig_of_more_markers_than_there_are_labels_is_refused() -> None:
    for count in (1, 256):
        markers = tuple((f'm{i}', (0, i, i * i)) for i in range(count))
        rig = MarkerRig('many', markers, (0, 0, 0), (0, 0, 0))
        with pytest.raises(ParameterError, match='many: tracking needs 2 to 255 markers'):
            MarkerTracker(MarkerTrackerParameters(allow_ambiguous=True), rig)


@pytest.mark.parametrize(
    'markers',
    [
        (('a', (0, 1)), ('b', (1, 0)), ('c', (1, 1))),
        (('a', (0, 1, math.nan)),),
        (('a', (0, 1, 'z')),),
        (('a', (0, 1, 2)), ('a', (0, 1, 3))),
        (),
    ],
)
def test_positions_that_are_none_are_refused(markers: tuple[tuple[str, tuple]]) -> None:
    with pytest.raises(RigError):
        MarkerRig('flat', markers, (0, 0, 0), (0, 0, 0))


def test_the_runway_detectors_say_which_mode_they_run(tmp_path: Path) -> None:
    file = tmp_path / 'parameters.yaml'
    file.write_text('runway_detector: {ros__parameters: {mode: approach}}')
    parameters = load_parameters(file, 'runway_detector')
    with pytest.raises(ParameterError, match='ApproachDetector'):
        RunwayDetector(parameters)
    with pytest.raises(ParameterError, match='ApproachDetector'):
        RunwayDetector().configure(parameters)
    assert 'all alike' in ApproachDetector(parameters).process(GRAY, 0).status


@pytest.mark.parametrize('make', [MarkerTracker, RunwayDetector, ApproachDetector])
@pytest.mark.parametrize(
    'image',
    [
        GRAY,
        GRAY.astype(np.uint16),
        GRAY[:, :, None],
        np.zeros((120, 160, 3), np.uint8),
        np.zeros((120, 160, 3), np.uint16),
        Image(GRAY, 'mono8'),
        Image(GRAY[:, :, None], 'mono8'),
        Image(np.zeros((120, 160, 3), np.uint8), 'rgb8'),
    ],
)
def test_every_detector_takes_arrays_and_images(make: type, image: object) -> None:
    assert make().process(image, 0).status


@pytest.mark.parametrize('make', [MarkerTracker, RunwayDetector, ApproachDetector])
@pytest.mark.parametrize(
    ('image', 'words'),
    [
        (np.zeros((120, 160), np.float32), r'not \(120, 160\) of float32'),
        (np.zeros((120, 160, 2), np.uint8), r'not \(120, 160, 2\) of uint8'),
        ([[0, 1]], 'not list'),
        (None, 'not NoneType'),
    ],
)
def test_what_is_no_image_is_named(make: type, image: object, words: str) -> None:
    with pytest.raises(ImageError, match=words):
        make().process(image, 0)


@pytest.mark.parametrize('make', [MarkerTracker, RunwayDetector, ApproachDetector])
def test_stamps_that_go_back_are_refused_until_a_reset(make: type) -> None:
    detector = make()
    detector.process(GRAY, 1_000)
    with pytest.raises(ValueError, match='stamp 999 ns'):
        detector.process(GRAY, 999)
    detector.reset()
    detector.process(GRAY, 999)


def test_a_pose_takes_nanoseconds_and_no_seconds() -> None:
    camera = CameraModel(640, 480, np.diag((600.0, 600.0, 1.0)))
    with pytest.raises(TypeError):
        PoseEstimator(MarkerTracker().rig).estimate(camera, [], np.empty((0, 2)), 0.033)


def test_a_calibration_as_opencv_gives_it_is_used() -> None:
    settings = {'motion': 'docking', 'frames': 20, 'distortion': '-0.2,0.05,0,0'}
    flight = make_flight('tanker', settings)
    name = 'sim:tanker?' + '&'.join(f'{key}={value}' for key, value in settings.items())
    known = flight.camera
    given = CameraModel(640, 480, k=known.matrix, d=known.distortion.reshape(5, 1))
    frames, other = list(track(name)), list(track(open_source(name), given))
    for frame, same, true in zip(frames, other, flight, strict=True):
        assert frame.pose.translation == pytest.approx(same.pose.translation)
        distance = float(np.linalg.norm(true.truth.translation))
        assert np.linalg.norm(frame.pose.translation) == pytest.approx(distance, rel=0.005)


class Broken(FrameSource):
    """Frames with a gap, a stamp that comes twice, and one that jumps back."""

    def __init__(self) -> None:
        self.closed = False

    def frames(self):
        images = [Frame(s, 'camera', Image(GRAY, 'mono8')) for s in (0, 33, 33, 66, 10)]
        yield from images[:2]
        yield BadFrame(50, 'cut off')
        yield from images[2:]

    def close(self) -> None:
        self.closed = True


class Unreadable(Broken):
    """Nothing but a frame that cannot be read, and one that cannot be used."""

    def frames(self):
        yield BadFrame(0, 'cut off')
        yield Frame(1, 'camera', Image(np.zeros((4, 5, 2), np.uint8), 'yuyv'))


def test_every_frame_is_answered_also_those_that_cannot_be_used() -> None:
    source = Broken()
    frames = list(track(source))
    assert [frame.stamp_ns for frame in frames] == [0, 33, 50, 33, 66, 10]
    assert [frame.image is None for frame in frames] == [False, False, True, True, False, False]
    assert frames[2].status == 'cut off' and frames[3].status == 'a stamp came twice'
    assert all(math.isnan(frame.roll) and frame.pose is None for frame in frames)
    assert [marker.state.name for marker in frames[2].markers.values()] == ['LOST'] * 5
    assert frames[2].markers.keys() == frames[0].markers.keys()
    parameters = MarkerTrackerParameters(mode='track_any', channel='red')
    unread, unused = track(Unreadable(), parameters=parameters)
    assert not unread.markers and not unused.markers
    assert unused.image is None and 'yuyv of 5 x 4 does not convert' in unused.status
    assert source.closed
    assert draw(frames[0]).shape == (120, 160, 3)
    with pytest.raises(ValueError, match='no image'):
        draw(frames[2])


class SlidingOut(Broken):
    """The tanker's lights move to the left, until the border cuts the left wing's off."""

    places = np.linspace(-10.0, -11.5, 16)

    def frames(self):
        for number, x in enumerate(self.places):
            pixels = np.full((480, 640), 60, np.uint8)
            seen = TANKER_CAMERA.project(TANKER_747.positions @ OPTICAL_FROM_BODY.T + (x, 0, 90))
            add_lights(pixels, [Light(6.0, place[None]) for place in seen])
            yield Frame(number * 33_000_000, 'camera', Image(pixels, 'mono8'))


def test_a_light_that_the_border_cuts_off_does_not_pull_the_pose() -> None:
    frames = list(track(SlidingOut(), TANKER_CAMERA))
    cut = [frame for frame in frames if frame.status]
    assert len(cut) > 5 and not frames[0].status
    assert {frame.status for frame in cut} == {'cut off by the border of the image: left_wing'}
    assert all(frame.markers['left_wing'].state.name == 'DETECTED' for frame in frames)
    errors = [f.pose.translation[0] - x for f, x in zip(frames, SlidingOut.places, strict=True)]
    assert max(map(abs, errors)) < 0.01


def test_the_generator_gives_what_replay_gives(tmp_path: Path) -> None:
    from support.commands import mvuav, read

    from mvuav_ros.messages.definitions import decode_message

    out = tmp_path / 'out.mcap'
    bag = ROOT / 'bags' / 'tanker.mcap'
    assert mvuav('replay', bag, '-o', out, '--nodes', 'marker_tracker', '--duration', 1).status == 0
    rolls = [
        decode_message(m.type, m.data).vector.x
        for m in read(out)
        if m.topic == '/marker_tracker/rpy'
    ]
    assert len(rolls) == 15
    assert [frame.roll for frame in islice(track(bag), 15)] == rolls


def test_a_calibration_of_another_size_or_file_is_refused(tmp_path: Path) -> None:
    camera = CameraModel(320, 240, np.diag((600.0, 600.0, 1.0)))
    with pytest.raises(CalibrationError, match='for 320 x 240 px'):
        next(track(ROOT / 'bags' / 'tanker.mcap', camera))
    assert load_calibration(ROOT / 'examples' / 'camera.yaml').width == 640


def test_results_of_every_detector_can_be_drawn() -> None:
    frame = cv2.line(np.zeros((120, 160, 3), np.uint8), (50, 0), (50, 119), (255,) * 3, 3)
    parameters = RunwayDetectorParameters(start_row=0, end_row=0)
    assert draw(RunwayDetector(parameters).process(frame, 0)).shape == (120, 160, 3)
    assert draw(ApproachDetector().process(frame, 0)).shape == (120, 160, 3)
    assert draw(MarkerTracker().process(frame, 0), frame).shape == (120, 160, 3)
    with pytest.raises(ValueError, match='no image'):
        draw(MarkerTracker().process(frame, 0))


def test_the_public_names_have_examples_that_run() -> None:
    """Of doctest; `make test` runs them all."""
    for name in set(mvuav_ros.__all__) - {'__version__'}:
        assert '>>> ' in getattr(mvuav_ros, name).__doc__, name


def test_without_a_calibration_there_is_a_reason_for_no_pose(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / '0.png'), GRAY)
    (frame,) = track(tmp_path)
    assert frame.pose is None and 'no pose: no calibration' in frame.status
    for given in ({'pose': False}, {'mode': 'track_any'}, {'mode': 'detect_any'}):
        (frame,) = track(tmp_path, parameters=MarkerTrackerParameters.from_mapping(given))
        assert 'no pose' not in frame.status


def test_a_calibration_beyond_belief_is_none_to_be_tracked_with() -> None:
    bent = CameraModel(640, 480, (1, 0, 0, 0, 1, 0, 0, 0, 1), (-10, 100, 1, 1, -1000))
    assert len(list(track('sim:tanker?motion=roll&frames=25', camera=bent))) == 25


def test_a_source_is_named_by_a_text_a_path_or_a_number(tmp_path: Path) -> None:
    file = tmp_path / 'dark.png'
    cv2.imwrite(str(file), GRAY)
    assert open_source(file).count == len(list(track(file))) == 1
    assert open_source(0).live
    with pytest.raises(SourceError, match='None: there is no such file'):
        track(None)  # type: ignore[arg-type]


@pytest.mark.parametrize('made', [MarkerTracker, RunwayDetector, ApproachDetector])
@pytest.mark.parametrize('wrong', [{'mode': 'track'}, 'mine.yaml', VideoSourceParameters()])
def test_parameters_of_another_kind_are_refused_at_once(made: Any, wrong: object) -> None:
    with pytest.raises(TypeError, match=r'must be .*DetectorParameters|must be MarkerTrackerP'):
        made(wrong)
    detector = made()
    with pytest.raises(TypeError, match=r'must be .*DetectorParameters|must be MarkerTrackerP'):
        detector.configure(wrong)
    assert detector.process(GRAY, 0).status


@pytest.mark.parametrize('made', [lambda rig: MarkerTracker(rig=rig), PoseEstimator])
def test_a_rig_may_be_named_by_its_file(made: Any, rig_file: Path, tmp_path: Path) -> None:
    for named in (rig_file, str(rig_file)):
        assert made(named)
    with pytest.raises(RigError, match=r'no_rig\.yaml: No such file'):
        made(tmp_path / 'no_rig.yaml')
    with pytest.raises(TypeError, match='rig must be a MarkerRig or its file, not dict'):
        made({'left': [0, 1, 0]})


@pytest.mark.parametrize('wrong', [3, 'camera.yaml', {}, np.zeros((3, 3))])
def test_what_is_no_calibration_attitude_or_result_is_refused_at_once(wrong: Any) -> None:
    """Not by an AttributeError some frames later."""
    estimator, seen = PoseEstimator(TANKER_747), (range(5), np.zeros((5, 2)), 0)
    for take in (MarkerTracker().set_camera, ApproachDetector().set_camera):
        with pytest.raises(TypeError, match='camera must be a CameraModel'):
            take(wrong)
    with pytest.raises(TypeError, match='camera must be a CameraModel'):
        estimator.estimate(wrong, *seen)
    if not isinstance(wrong, str):
        with pytest.raises(TypeError, match='camera must be a CameraModel'):
            track('sim:tanker', camera=wrong)
    with pytest.raises(TypeError, match='attitude must be an Attitude or a HorizonLine'):
        ApproachDetector().process(GRAY, 0, wrong)
    with pytest.raises(TypeError, match='found must be what track or a detector gives'):
        draw(wrong, GRAY)
    with pytest.raises(TypeError, match='integer'):
        CameraModel(640.5 if isinstance(wrong, int) else wrong, 480, k=np.eye(3))
    with pytest.raises(SourceError, match='no image topic'):
        open_source(ROOT / 'bags' / 'tanker.mcap', topic=wrong)


@pytest.mark.parametrize('made', [MarkerTracker, ApproachDetector])
@pytest.mark.parametrize(
    'wrong',
    [None, (0.0, 20.0, 0.0), np.eye(4), 2 * np.eye(3), np.diag((1, 1, -1)), np.nan * np.eye(3)],
)
def test_a_mount_that_is_no_rotation_is_refused_at_once(made: Any, wrong: Any) -> None:
    """Not frames later, nor taken for another mount."""
    detector = made()
    detector.set_mount(np.eye(3).tolist())
    with pytest.raises(ValueError, match='rotation matrix'):
        detector.set_mount(wrong)
    assert detector.process(GRAY, 0).status

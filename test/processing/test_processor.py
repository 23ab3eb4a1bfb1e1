"""What every processor does with stamps, whatever it computes; what is known first."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from support.boards import LENSES
from support.marker_scenes import image, tanker_at

from mvuav_ros.messages.images import Frame
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.processing.marker_processor import MarkerTrackerProcessor
from mvuav_ros.processing.processor import DuplicateStampError, resolve
from mvuav_ros.processing.runway_processor import RunwayDetectorProcessor
from mvuav_ros.simulation.runway_flight import RunwayFlight
from mvuav_ros.simulation.settings import RunwaySettings
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image, ImageError
from mvuav_ros.vision.pose import PoseEstimator

STEP_NS = 100_000_000


def frame(step):
    return Frame(step * STEP_NS, 'camera', image(tanker_at(320 + 2 * step)))


def results(processor, step):
    return [(output.topic, output.make()) for output in processor.process(frame(step))]


def test_a_stamp_that_comes_twice_is_refused_and_leaves_no_trace():
    processor, undisturbed = MarkerTrackerProcessor(), MarkerTrackerProcessor()
    for step in range(5):
        assert results(processor, step) == results(undisturbed, step)
        with pytest.raises(DuplicateStampError, match=f'{step * STEP_NS} ns came twice'):
            list(processor.process(frame(step)))
    assert processor.resets == 0


def test_a_stamp_that_jumps_back_starts_afresh():
    processor = MarkerTrackerProcessor()
    first = [results(processor, step) for step in range(5)]
    again = [results(processor, step) for step in range(5)]
    assert processor.resets == 1
    assert again == first


def test_a_bag_of_images_that_do_not_convert_may_loop():
    """Each is an image that cannot be used, and the tracker has seen its stamp."""
    processor = MarkerTrackerProcessor()
    odd = Image(np.zeros((48, 63, 2), np.uint8), 'uyvy')
    for step in (1, 2, 1, 2):
        with pytest.raises(ImageError, match='does not convert'):
            list(processor.process(Frame(step * STEP_NS, 'camera', odd)))
    with pytest.raises(DuplicateStampError):
        results(processor, 2)
    assert processor.resets == 1


def test_a_duplicate_after_a_reset_is_a_first_frame():
    processor = MarkerTrackerProcessor()
    first = results(processor, 3)
    processor.reset()
    assert results(processor, 3) == first
    assert processor.resets == 0


def test_topics_of_all_nodes_keep_their_full_name():
    assert resolve('/tf', '/marker_tracker') == '/tf'
    assert resolve('rpy', '/marker_tracker') == '/marker_tracker/rpy'
    assert resolve('rpy') == '~/rpy'


def test_markers_can_be_sent_before_the_pose_is_worked_out(monkeypatch):
    estimated = []
    monkeypatch.setattr(PoseEstimator, 'estimate', lambda *_: estimated.append(True))
    seen = replace(frame(0), camera=LENSES['plumb_bob'])
    outputs = MarkerTrackerProcessor().process(seen)
    assert next(outputs).topic == 'markers'
    assert not estimated
    assert [next(outputs).topic, next(outputs).topic] == ['rpy', 'pose']
    assert estimated


def test_lines_are_sent_before_they_are_counted():
    """Known lines do not hang on the statistics, nor these on them; frames without lines count."""
    processor = RunwayDetectorProcessor(RunwayDetectorParameters(num_peaks=1))

    def counts():
        summary = processor._statistics.summary()
        return summary.frames, summary.rho_flags

    def show(step, column=None):
        pixels = np.full((240, 320), 60, np.uint8)
        if column is not None:
            pixels[:, column : column + 3] = 220
        yield from processor.process(Frame(step, 'camera', Image(pixels, 'mono8')))

    outputs = show(1)
    assert next(outputs).topic == 'line_params' and counts() == (0, 0)
    list(outputs)
    assert counts() == (1, 0)
    for step in (2, 3):
        list(show(step, 100))
    processor.reset_statistics()
    assert counts() == (0, 0)
    list(show(4, 250))
    assert counts() == (1, 1)
    processor.reset()
    list(show(5, 250))
    assert counts() == (2, 1)


def test_a_calibration_that_cannot_be_used_is_none():
    """All zeros, as a driver without a calibration has it, were 'K and d (without a name)'."""
    processor = RunwayDetectorProcessor()
    assert processor.calibration == 'none'
    processor.set_camera(CameraModel(640, 480, (0.0,) * 9, distortion_model=''))
    assert processor.calibration == 'none: camera_info is all zeros: the camera is not calibrated'
    processor.set_camera(CameraModel(640, 480, (500.0, 0, 320, 0, 500.0, 240, 0, 0, 1)))
    assert processor.calibration == 'K and d (plumb_bob)'


def test_a_stamp_behind_that_of_an_image_that_is_refused_is_a_jump_back():
    """It was an internal error."""
    processor = MarkerTrackerProcessor(MarkerTrackerParameters(channel='red'))
    results(processor, 1)
    odd = Image(np.zeros((48, 65, 2), np.uint8), 'yuv422')
    with pytest.raises(ImageError, match='does not convert'):
        list(processor.process(replace(frame(3), image=odd)))
    assert results(processor, 2) and processor.resets == 1


def test_mode_approach_says_why_a_calibration_gives_no_pose():
    """With one of another image size all seemed well, and there was no pose."""
    flight = RunwayFlight(RunwaySettings(frames=1, width=320, height=240))
    camera = flight.camera
    (seen,) = (Frame(each.stamp_ns, 'camera', each.image, camera) for each in flight)
    other = replace(seen, camera=replace(camera, width=640, height=480))
    for shown, width, words in ((seen, 30.0, ''), (other, 0.0, ''), (other, 30.0, 'no pose: ')):
        processor = RunwayDetectorProcessor(
            RunwayDetectorParameters(mode='approach', runway_width=width)
        )
        list(processor.process(shown))
        expected = words and f'{words}camera_info is for 640 x 480 px, the images are 320 x 240 px'
        assert expected in processor.status
        assert ('no pose' in processor.status) == bool(words)
    assert processor.awaits_camera_info and processor.draw(processor.debug_topics)
    # Another mode has nothing to draw yet, and needs the first calibration alone.
    processor.configure(RunwayDetectorParameters(mode='thesis'))
    assert not processor.awaits_camera_info and processor.draw(processor.debug_topics) == []
    assert RunwayDetectorProcessor().awaits_camera_info


def test_lights_without_names_need_no_calibration():
    """Beside a camera without one a node in mode track_any warned for ever that it has no pose."""
    processor = MarkerTrackerProcessor(MarkerTrackerParameters(mode='track_any'))
    processor.set_camera(CameraModel(640, 480, (0.0,) * 9))
    assert results(processor, 1) and processor.status == ''
    assert not processor.awaits_camera_info


FRAMES_OF_A_FRESH_PROCESS = """
import sys
from mvuav_ros.processing.process_tuning import tune_process
from mvuav_ros.processing.registry import PROCESSORS
from mvuav_ros.sources.opening import open_source

name, mode, bag = sys.argv[1:]
processor = PROCESSORS[name]()
processor.configure(processor.parameters_type.from_mapping({'mode': mode}))
frames = list(open_source(bag).frames())
tune_process()
before = set(sys.modules)
for frame in frames[:40]:
    for output in [*processor.process(frame), *processor.draw(processor.debug_topics)]:
        output.make()
print(*sorted(set(sys.modules) - before))
"""


@pytest.mark.parametrize(
    ('name', 'mode', 'bag'),
    [
        ('marker_tracker', 'track', 'tanker'),
        ('runway_detector', 'thesis', 'runway'),
        ('runway_detector', 'approach', 'runway'),
    ],
)
def test_no_frame_of_a_node_waits_for_an_import(name, mode, bag):
    path = f'bags/{bag}.mcap'
    command = [sys.executable, '-c', FRAMES_OF_A_FRESH_PROCESS, name, mode, path]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.split() == []

"""What every processor does with stamps, whatever it computes; what is known first."""

from dataclasses import replace

import numpy as np
import pytest
from support.boards import LENSES
from support.marker_scenes import image, tanker_at

from mvuav_ros.messages.images import Frame
from mvuav_ros.processing.marker_processor import MarkerTrackerProcessor
from mvuav_ros.processing.processor import DuplicateStampError, resolve
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

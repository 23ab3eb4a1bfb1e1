"""From the simulator's attitude sensor through a bag to the detector."""

from dataclasses import astuple, replace

import pytest

from mvuav_ros.offline.frame_messages import frame_messages
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.processing.runway_processor import RunwayDetectorProcessor
from mvuav_ros.recordings.writing import RecordingWriter
from mvuav_ros.simulation.runway_flight import ATTITUDE_SIGMA
from mvuav_ros.sources.bag import BagImages
from mvuav_ros.sources.opening import make_flight, open_source
from mvuav_ros.vision.approach.attitude import horizon_from, mount_matrix

FRAMES = 4
FLIGHT = f'sim:runway?frames={FRAMES}&width=320&height=240&seed=1'


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp('flight') / 'flight.mcap'
    write_flight(path)
    return path


def write_flight(path, sensor_ahead_s=0):
    """A bag whose attitude has stamps of a clock so many seconds ahead."""
    flight = open_source(FLIGHT)
    with RecordingWriter(path) as writer:
        for frame in flight.frames():
            for topic, kind, make in frame_messages(frame):
                data = make()
                if topic == '/imu':
                    seconds = int.from_bytes(data[4:8], 'little') + sensor_ahead_s
                    data = data[:4] + seconds.to_bytes(4, 'little') + data[8:]
                writer.write(topic, kind, frame.stamp_ns, data)


def test_frames_of_the_bag_have_the_attitude_that_was_written(bag):
    source = BagImages(bag)
    assert source.imu_topic == '/imu'
    frames = list(source.items(camera=True, attitude=True))
    flight = make_flight('runway', {'frames': FRAMES, 'width': 320, 'height': 240})
    assert len(frames) == FRAMES
    for index, frame in enumerate(frames):
        horizon = horizon_from(frame.attitude, frame.camera, mount_matrix((0.0, 0.0, 0.0)))
        # The vanishing point lies on the horizon, but for the sensor's bias: 10 px are 2 degrees.
        assert abs(horizon.row - flight.truth(index).vanishing_point[1]) < 10
        assert horizon.sigma == pytest.approx(ATTITUDE_SIGMA)


def test_a_flight_that_is_evaluated_as_it_is_has_the_attitude_of_its_bag(bag):
    """It had none, though the simulation knows it."""
    found = [astuple(frame.attitude) for frame in open_source(FLIGHT).frames()]
    recorded = [astuple(frame.attitude) for frame in BagImages(bag).frames()]
    assert found == [pytest.approx(each, rel=1e-12) for each in recorded]


def test_attitude_is_left_out_where_it_is_not_asked_for(bag):
    assert all(frame.attitude is None for frame in BagImages(bag).items(camera=True))


def test_the_node_says_that_attitude_was_lost(bag):
    frames = list(BagImages(bag).frames())
    processor = RunwayDetectorProcessor(RunwayDetectorParameters(mode='approach'))
    list(processor.process(frames[0]))
    assert 'attitude' not in processor.status
    list(processor.process(replace(frames[1], attitude=None)))
    assert 'no attitude' in processor.status


@pytest.mark.parametrize('ahead_s', [1000, -1000])
def test_the_node_says_that_attitude_has_another_clock(tmp_path, ahead_s):
    """It flew without the sensor, and all seemed well."""
    write_flight(tmp_path / 'flight.mcap', ahead_s)
    frames = list(BagImages(tmp_path / 'flight.mcap').frames())
    processor = RunwayDetectorProcessor(RunwayDetectorParameters(mode='approach'))
    for frame in frames[1:]:
        list(processor.process(frame))
        assert "no attitude for this image: the horizon is the image's" in processor.status


def test_waiting_for_attitude_depends_on_the_mode():
    assert not RunwayDetectorProcessor(RunwayDetectorParameters()).awaits_attitude
    approach = RunwayDetectorParameters(mode='approach')
    assert RunwayDetectorProcessor(approach).awaits_attitude
    image = approach.changed({'horizon_source': 'image'})
    assert not RunwayDetectorProcessor(image).awaits_attitude

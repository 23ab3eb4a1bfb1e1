"""`mvuav simulate`: bags with images, calibration and truth."""

import subprocess
import sys

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, Vector3Stamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, Image, Imu, PointCloud2
from support.commands import mvuav
from support.node_outputs import messages_of as messages_from
from support.places import ROOT

from mvuav_ros.messages.cdr import view_points
from mvuav_ros.messages.images import decode_image
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.processing.marker_processor import MarkerTrackerProcessor
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.sources.bag import BagImages

TYPES = {
    '/image_raw': Image,
    '/camera_info': CameraInfo,
    '/truth/markers': PointCloud2,
    '/truth/lines': PointCloud2,
    '/truth/rpy': Vector3Stamped,
    '/truth/pose': PoseStamped,
    '/imu': Imu,
}


def simulate(*arguments):
    command = [sys.executable, '-m', 'mvuav_ros', 'mvuav', 'simulate', *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)


def messages_of(path):
    with open_recording(path) as recording:
        messages = {}
        for message in recording.messages():
            decoded = deserialize_message(message.data, TYPES[message.topic])
            messages.setdefault(message.topic, []).append(decoded)
    return messages


def test_a_tanker_flight_and_what_the_tracker_makes_of_it(tmp_path):
    bag = tmp_path / 'tanker.mcap'
    result = simulate('tanker', '-o', bag, '--frames', 12, '--fps', 20, '--seed', 3)
    assert result.returncode == 0, result.stderr
    messages = messages_of(bag)
    assert {topic: len(found) for topic, found in messages.items()} == dict.fromkeys(
        ('/image_raw', '/camera_info', '/truth/markers', '/truth/rpy', '/truth/pose'), 12
    )
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages['/image_raw']]
    assert set(np.diff(stamps)) == {50_000_000}
    for found in messages.values():
        assert [m.header for m in found] == [m.header for m in messages['/image_raw']]
    tracker = MarkerTrackerProcessor(MarkerTrackerParameters(mode='detect'))
    frames = BagImages(bag).frames()
    for frame, truth, roll in zip(
        frames, messages['/truth/markers'], messages['/truth/rpy'], strict=True
    ):
        outputs = messages_from(tracker, tracker.process(frame))
        found, true = view_points(outputs['markers']), view_points(truth)
        assert list(true['label']) == [0, 1, 2, 3, 4]
        np.testing.assert_allclose(found['x'], true['x'], atol=0.4)
        np.testing.assert_allclose(found['y'], true['y'], atol=0.4)
        assert outputs['rpy'].vector.x == pytest.approx(roll.vector.x, abs=0.004)


def test_a_runway_flight(tmp_path):
    bag = tmp_path / 'runway.mcap'
    result = simulate('runway', '-o', bag, '--frames', 3, '--size', '160x120')
    assert result.returncode == 0, result.stderr
    messages = messages_of(bag)
    assert decode_image(messages['/image_raw'][0]).pixels.shape == (120, 160, 3)
    lines = view_points(messages['/truth/lines'][0])
    assert len(lines) == 5
    for line in lines[np.isfinite(lines['rho'])]:
        for x, y in ((line['x'], line['y']), (line['x2'], line['y2'])):
            normal = np.cos(line['theta']), np.sin(line['theta'])
            assert x * normal[0] + y * normal[1] == pytest.approx(line['rho'], abs=0.01)
    assert messages['/camera_info'][0].k[0] > 0


def test_a_seed_changes_the_flight_and_repeats_it(tmp_path):
    bags = [tmp_path / f'{name}.mcap' for name in 'abc']
    for bag, seed in zip(bags, (1, 1, 2), strict=True):
        simulate('tanker', '-o', bag, '--frames', 3, '--size', '160x120', '--seed', seed)
    a, b, c = (repr(messages_of(path)) for path in bags)
    assert a == b
    assert a != c


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (('--shake', 9), 'shake: must be 0 to 3'),
        (('--size', 'large'), 'write WxH'),
        (('--size', '640x48²'), 'write WxH'),
        (('--motion', 'looping'), 'motion: must be one of'),
        (('--frames', 'many'), '--frames'),
    ],
)
def test_mistakes_are_one_clear_line(tmp_path, arguments, words):
    result = simulate('tanker', '-o', tmp_path / 'x.mcap', *arguments)
    assert result.returncode in (1, 2)
    (line,) = result.stderr.strip().splitlines()
    assert line.startswith('mvuav: ') and words in line


def test_an_existing_file_is_kept(tmp_path):
    bag = tmp_path / 'x.mcap'
    bag.write_text('precious')
    result = simulate('tanker', '-o', bag, '--frames', 2)
    assert result.returncode == 1 and '--force' in result.stderr
    assert bag.read_text() == 'precious'


def test_the_sample_bags_are_what_make_bags_writes(tmp_path):
    """The recipe in the Makefile still gives the flights in bags/."""
    recipe = (ROOT / 'Makefile').read_text()
    for kind in ('tanker', 'runway'):
        start = recipe.index(f'simulate {kind} -o bags/{kind}.mcap --force')
        text = recipe[start : recipe.index('\n\t$(BIN)', start) if kind == 'tanker' else None]
        text = text.split('\n\n')[0].replace('\\\n', ' ').replace("'", '')
        words = text.split()[3:]
        words = [w for w in words if w != '--force' and not w.startswith('bags/')]
        bag = tmp_path / f'{kind}.mcap'
        assert simulate(kind, '-o', bag, *words).returncode == 0
        again, kept = messages_of(bag), messages_of(ROOT / 'bags' / f'{kind}.mcap')
        assert len(again['/image_raw']) == len(kept['/image_raw'])
        for mine, theirs in list(zip(again['/image_raw'], kept['/image_raw'], strict=True))[::20]:
            difference = np.abs(decode_image(mine).pixels.astype(int) - decode_image(theirs).pixels)
            # Other versions of NumPy and OpenCV round differently.
            assert difference.mean() < 0.5


def test_a_folder_is_no_name_for_a_flight(tmp_path):
    for force in ((), ('--force',)):
        run = mvuav('simulate', 'tanker', '-o', tmp_path, *force)
        assert run.error == f'mvuav: {tmp_path} is a folder; give the name of a file'

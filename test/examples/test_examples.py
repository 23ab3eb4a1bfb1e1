"""Every example runs as its first line says, and prints what it promises."""

import math
import os
import signal
import subprocess
import sys

import cv2
import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped, Vector3, Vector3Stamped
from support.commands import started
from support.graph import Graph
from support.marker_scenes import draw, tanker_at
from support.places import ROOT

EXAMPLES = sorted(path.stem for path in (ROOT / 'examples').glob('*.py'))


def run(name, *arguments):
    done = execute(name, *arguments)
    assert done.returncode == 0, done.stderr
    return done.stdout


def execute(name, *arguments):
    command = [sys.executable, f'examples/{name}.py', *map(str, arguments)]
    environment = {**os.environ, 'PYTHONPATH': str(ROOT)}
    return subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=120
    )


def test_detect_in_one_image(tmp_path):
    cv2.imwrite(str(tmp_path / 'frame.png'), draw(tanker_at()))
    out = run('detect_in_one_image', tmp_path / 'frame.png')
    assert out.count('detected at') == 5
    assert 'roll 0.0000 rad' in out or 'roll -0.0000 rad' in out


def test_replay_a_bag():
    out = run('replay_a_bag', 'bags/tanker.mcap').splitlines()
    assert len(out) == 180
    assert sum('5 of 5' in line for line in out) > 160


def test_replay_a_bag_goes_on_after_a_broken_image(tmp_path):
    for number in range(3):
        cv2.imwrite(str(tmp_path / f'{number}.png'), np.zeros((48, 64), np.uint8))
    (tmp_path / '1.png').write_bytes(b'torn')
    out = run('replay_a_bag', str(tmp_path)).splitlines()
    assert len(out) == 3 and '1.png' in out[1] and '0 of 5' in out[2]


def test_own_marker_rig():
    assert '[0.5 0.2 8. ]' in run('own_marker_rig')


def test_approach_with_guidance():
    out = run('approach_with_guidance').splitlines()
    assert len(out) == 40
    assert all(np.isfinite(float(line.split('confidence ')[1].split()[0])) for line in out)
    offset, height = (float(word.split()[1]) for word in out[-1].split(', ')[:2])
    assert offset == pytest.approx(7.0, abs=1.0) and height == pytest.approx(42.9, abs=4.0)


def test_print_live_results():
    graph = Graph()
    try:
        publisher = graph.probe.create_publisher(Vector3Stamped, '/marker_tracker/rpy', 10)
        command = [sys.executable, 'examples/print_live_results.py', '3']
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(graph.domain_id)}
        with started(
            command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True
        ) as listener:
            graph.until(lambda: publisher.get_subscription_count() > 0, 'the listener')
            message = Vector3Stamped(vector=Vector3(x=math.radians(12.0)))
            while listener.poll() is None:
                publisher.publish(message)
                graph.spin(0.1)
            assert listener.stdout.read() == 'roll 12.0 deg\n' * 3
    finally:
        graph.close()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_print_live_results_ends_without_a_traceback(number):
    graph = Graph()
    try:
        publisher = graph.probe.create_publisher(Vector3Stamped, '/marker_tracker/rpy', 10)
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(graph.domain_id)}
        with started(
            [sys.executable, 'examples/print_live_results.py', '1000'],
            cwd=ROOT,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as listener:
            graph.until(lambda: publisher.get_subscription_count() > 0, 'the listener')
            publisher.publish(Vector3Stamped())
            # In its first moment, as it makes its executor, rclpy itself may print a traceback.
            assert listener.stdout.readline() == 'roll 0.0 deg\n'
            listener.send_signal(number)
            assert listener.communicate(timeout=120)[1] == ''
            assert listener.returncode == 0
    finally:
        graph.close()


LEVEL = PoseWithCovarianceStamped()
LEVEL.pose.pose.position.x, LEVEL.pose.pose.position.y = -100.0, 2.0
LEVEL.pose.pose.position.z, LEVEL.pose.pose.orientation.w = 30.0, 1.0
LEVEL.pose.covariance = np.diag([9.0, 4.0, 1.0, 0.1, 0.2, 0.3]).ravel().tolist()
PX4_MSGS = """
import os, signal, sys, types
import numpy as np
from dataclasses import dataclass
import rclpy.node
@dataclass
class VehicleOdometry:
    timestamp: int
    timestamp_sample: int
    pose_frame: int
sys.modules['px4_msgs'] = types.ModuleType('px4_msgs')
sys.modules['px4_msgs.msg'] = types.SimpleNamespace(VehicleOdometry=VehicleOdometry)
class Out:
    def publish(self, said):
        print({name: np.asarray(value).tolist() for name, value in vars(said).items()})
        os.kill(os.getpid(), signal.SIGINT)
made = rclpy.node.Node.create_publisher
def create(self, kind, topic, *more, **others):
    if kind is not VehicleOdometry:
        return made(self, kind, topic, *more, **others)
    print(topic)
    return Out()
rclpy.node.Node.create_publisher = create
sys.argv[:] = ['pose_for_px4.py', '90']
exec(open('examples/pose_for_px4.py').read())
"""


def flown(command, number):
    """Publish a level pose 100 m before the runway until the example has answered; then stop it."""
    graph = Graph()
    try:
        publisher = graph.probe.create_publisher(
            PoseWithCovarianceStamped, '/runway_detector/vision_pose', 10
        )
        kept = []
        graph.probe.create_subscription(
            PoseWithCovarianceStamped, '/mavros/vision_pose/pose_cov', kept.append, 10
        )
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(graph.domain_id), 'PYTHONPATH': str(ROOT)}
        pipes = {'stdout': subprocess.PIPE, 'stderr': subprocess.PIPE, 'text': True}
        command = [sys.executable, *command]
        with started(command, cwd=ROOT, env=environment, **pipes) as example:
            while not kept and example.poll() is None:
                publisher.publish(LEVEL)
                graph.spin(0.1)
            example.send_signal(number)
            out, errors = example.communicate(timeout=120)
            assert (example.returncode, errors) == (0, '')
            return kept, out
    finally:
        graph.close()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_pose_for_mavros(number):
    """South of a runway that is landed on northwards, 2 m to the west of its centreline."""
    kept, _ = flown(['examples/pose_for_mavros.py', '0'], number)
    pose = kept[0].pose.pose
    assert (pose.position.x, pose.position.y, pose.position.z) == pytest.approx((-2, -100, 30))
    assert (pose.orientation.z, pose.orientation.w) == pytest.approx((0.5**0.5, 0.5**0.5))
    assert np.reshape(kept[0].pose.covariance, (6, 6)).diagonal() == pytest.approx(
        [4, 9, 1, 0.2, 0.1, 0.3]
    )


def test_pose_for_px4():
    """West of a runway that is landed on eastwards, north of its centreline; nose to the east."""
    _, out = flown(['-c', PX4_MSGS], signal.SIGTERM)
    topic, said = out.splitlines()
    assert topic == '/fmu/in/vehicle_visual_odometry'
    said = eval(said, {'nan': math.nan})
    assert said['pose_frame'] == 1
    assert said['position'] == pytest.approx([2, -100, -30])
    assert np.abs(said['q']) == pytest.approx([0.5**0.5, 0, 0, 0.5**0.5])
    assert said['q'][0] * said['q'][3] > 0
    assert said['position_variance'] == pytest.approx([4, 9, 1])
    assert said['orientation_variance'] == pytest.approx([0.1, 0.2, 0.3])
    assert all(map(math.isnan, said['velocity']))


def test_plot_a_result_bag(tmp_path):
    results, figure = tmp_path / 'results.mcap', tmp_path / 'roll.png'
    command = [sys.executable, '-m', 'mvuav_ros', 'mvuav', 'replay', 'bags/tanker.mcap']
    subprocess.run([*command, '-o', str(results)], cwd=ROOT, check=True, capture_output=True)
    assert '180 values' in run('plot_a_result_bag', results, figure)
    assert cv2.imread(str(figure)) is not None


@pytest.mark.parametrize(
    'name', ['detect_in_one_image', 'plot_a_result_bag', 'pose_for_mavros', 'replay_a_bag']
)
def test_a_missing_argument_gives_the_usage(name):
    done = execute(name)
    assert done.returncode == 1
    assert done.stderr.startswith(f'usage: python examples/{name}.py ')
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize('name', EXAMPLES)
def test_examples_are_short_and_tested(name):
    lines = (ROOT / 'examples' / f'{name}.py').read_text().splitlines()
    assert len([line for line in lines if line.strip()]) <= 26
    assert f'def test_{name}(' in (ROOT / 'test' / 'examples' / 'test_examples.py').read_text()

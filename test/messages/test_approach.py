"""What mode approach says on the node's topics."""

import math
from functools import lru_cache

import numpy as np
import pytest

pytest.importorskip('sensor_msgs')

from sensor_msgs.msg import PointField
from support.node_outputs import messages_of

from mvuav_ros.messages.cdr import view_points
from mvuav_ros.messages.images import Frame, decode_image
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.processing.runway_processor import RunwayDetectorProcessor
from mvuav_ros.simulation.runway_flight import RunwayFlight
from mvuav_ros.simulation.settings import RunwaySettings
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image

OFFSETS = {
    'x': 0,
    'y': 4,
    'z': 8,
    'x2': 12,
    'y2': 16,
    'rho': 20,
    'theta': 24,
    'votes': 28,
    'rho_raw': 32,
    'theta_raw': 36,
    'flags': 40,
    'role': 41,
    'confidence': 44,
}
ALWAYS = {'line_params', 'lines', 'corrections', 'vanishing_point', 'integrity'}


@lru_cache
def flight():
    return RunwayFlight(RunwaySettings(frames=60))


def camera():
    model = flight().camera
    return CameraModel(model.width, model.height, tuple(model.matrix.ravel()))


@lru_cache
def frame(index):
    simulated = flight().frame(index)
    return Frame(simulated.stamp_ns, 'camera', simulated.image)


EMPTY = Image(np.full((480, 640, 3), 90, np.uint8), 'bgr8')


def outputs(processor, index, debug=()):
    outputs = [*processor.process(frame(index)), *processor.draw(debug)]
    return messages_of(processor, outputs)


def flown(calibrated=True, **values):
    processor = RunwayDetectorProcessor(
        RunwayDetectorParameters.from_mapping({'mode': 'approach', **values})
    )
    if calibrated:
        processor.set_camera(camera())
    said = {}
    for index in range(20):
        said = outputs(processor, index, ('debug/overlay',) if index == 19 else ())
    return processor, said


@pytest.mark.parametrize('mode', ['thesis', 'approach'])
def test_later_fields_stand_behind_the_earlier_ones(mode):
    processor = RunwayDetectorProcessor(RunwayDetectorParameters(mode=mode))
    message = outputs(processor, 0)['line_params']
    assert {field.name: field.offset for field in message.fields} == OFFSETS
    types = {field.name: field.datatype for field in message.fields}
    assert types['role'] == PointField.UINT8
    assert types['confidence'] == PointField.FLOAT32
    assert message.point_step == 48
    assert len(message.data) == message.width * 48


def test_thesis_lines_have_no_role_and_no_confidence():
    said = outputs(RunwayDetectorProcessor(RunwayDetectorParameters(mode='thesis')), 0)
    rows = view_points(said['line_params'])
    assert np.isfinite(rows['rho']).any()
    assert (rows['role'] == 0).all()
    assert np.isnan(rows['confidence']).all()
    assert set(said) == ALWAYS
    assert math.isnan(said['vanishing_point'].point.x)


def test_five_rows_with_their_roles_in_their_colours():
    _, said = flown()
    rows = view_points(said['line_params'])
    assert rows['role'].tolist() == [1, 2, 3, 4, 5]
    assert np.isfinite(rows['rho']).all()
    assert (rows['confidence'] > 0.5).all() and (rows['confidence'] <= 1).all()
    # Left of right at the foot, the centreline between.
    assert rows['x2'][0] < rows['x2'][2] < rows['x2'][1]
    marker = said['lines']
    assert len(marker.points) == len(marker.colors) == 10
    colors = {(c.r, c.g, c.b) for c in marker.colors}
    assert len(colors) == 4, 'left, right, centreline, ends'
    names = [status.name for status in said['corrections'].status]
    assert names[:2] == ['line 1 (left_edge)', 'line 2 (right_edge)']


def test_vanishing_point_and_pose_agree_with_the_flight():
    _, said = flown(runway_width=30.0)
    truth = flight().frame(19).truth
    point = said['vanishing_point'].point
    assert math.dist((point.x, point.y), truth.vanishing_point) < 6
    assert point.z == 0
    pose = said['pose'].pose
    assert pose.pose.position.y == pytest.approx(truth.pose.position[1], abs=2)
    assert pose.pose.position.z == pytest.approx(truth.pose.position[2], rel=0.10)
    q = pose.pose.orientation
    assert q.x**2 + q.y**2 + q.z**2 + q.w**2 == pytest.approx(1)
    yaw = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))
    roll = math.atan2(2 * (q.w * q.x + q.y * q.z), 1 - 2 * (q.x**2 + q.y**2))
    pitch = math.asin(2 * (q.w * q.y - q.z * q.x))
    for angle, true in ((yaw, truth.pose.yaw), (roll, truth.pose.roll), (pitch, truth.pose.pitch)):
        assert math.degrees(angle) == pytest.approx(math.degrees(true), abs=0.5)
    covariance = np.reshape(pose.covariance, (6, 6))
    assert np.allclose(covariance, covariance.T)
    assert (np.linalg.eigvalsh(covariance[1:, 1:]) > 0).all()
    assert said['pose'].header.stamp == said['lines'].header.stamp
    assert (said['pose'].header.frame_id, said['lines'].header.frame_id) == ('runway', 'camera')


@pytest.mark.parametrize(
    ('calibrated', 'width', 'expected'),
    [(True, 30.0, True), (True, 0.0, False), (False, 30.0, False)],
)
def test_pose_needs_a_calibration_and_the_width(calibrated, width, expected):
    _, said = flown(calibrated, runway_width=width)
    assert ('pose' in said) is expected
    assert set(said) >= ALWAYS


def test_integrity_bounds_the_guidance_where_the_confidence_bears_it():
    # 0.05 of risk left for three errors: 2.39 deviations and more.
    processor, said = flown(runway_width=30.0, integrity_risk=0.36, alert_limit=[0.0, 1e-3])
    status = said['integrity'].status[0]
    values = {each.key: each.value for each in status.values}
    assert (status.level, status.message) == (b'\1', 'alert: height')
    pose = said['pose'].pose
    offset, height = (math.sqrt(pose.covariance[7 * axis]) for axis in (1, 2))
    assert float(values['offset']) > 1.2 * offset and float(values['height']) > 1.2 * height
    strict = processor._parameters.changed({'integrity_risk': 1e-7})
    processor.configure(strict)
    silent = outputs(processor, 20)['integrity'].status[0]
    assert silent.level == b'\2' and 'cannot bear a risk of 1e-07' in silent.message
    thesis = outputs(RunwayDetectorProcessor(), 0)['integrity'].status[0]
    assert thesis.message == 'not available: only mode approach has levels'


def test_without_a_horizon_the_roll_is_not_known():
    steep = RunwayFlight(RunwaySettings(frames=12, camera_pitch_deg=30.0, start_distance=60.0))
    processor = RunwayDetectorProcessor(
        RunwayDetectorParameters(mode='approach', runway_width=30.0)
    )
    processor.set_camera(camera())
    for simulated in steep:
        seen = Frame(simulated.stamp_ns, 'camera', simulated.image)
        said = messages_of(processor, processor.process(seen))
    assert said['integrity'].status[0].message == (
        'not available: no horizon tells the roll: give attitude'
    )
    pose = said['pose'].pose
    assert math.isfinite(pose.pose.position.y)
    assert pose.covariance[21] == pytest.approx(math.radians(10.0) ** 2, rel=0.1)


def test_absence_is_said_on_every_topic():
    processor = RunwayDetectorProcessor(
        RunwayDetectorParameters(mode='approach', runway_width=30.0)
    )
    processor.set_camera(camera())
    said = messages_of(processor, processor.process(Frame(1, 'camera', EMPTY)))
    assert set(said) == ALWAYS | {'pose'}
    rows = view_points(said['line_params'])
    assert rows['role'].tolist() == [1, 2, 3, 4, 5]
    for name in ('x', 'rho', 'theta', 'votes', 'confidence'):
        assert np.isnan(rows[name]).all()
    assert not said['line_params'].is_dense
    assert math.isnan(said['vanishing_point'].point.x)
    pose = said['pose'].pose
    assert math.isnan(pose.pose.position.x) and math.isnan(pose.pose.position.y)
    assert math.isnan(pose.pose.orientation.w)
    assert min(np.diag(np.reshape(pose.covariance, (6, 6)))) >= 1e9
    assert said['lines'].points == []
    assert processor.status


def test_the_overlay_shows_the_edges_on_the_frame():
    processor, said = flown(runway_width=30.0)
    image = decode_image(said['debug/overlay'])
    frame_pixels = frame(19).image.pixels
    assert image.pixels.shape == frame_pixels.shape
    rows = view_points(said['line_params'])
    changed = (image.pixels.astype(int) - frame_pixels).any(axis=2)
    for row in rows[:2]:
        x, y = 0.5 * (row['x'] + row['x2']), 0.5 * (row['y'] + row['y2'])
        assert changed[round(float(y)), round(float(x))]
    assert changed.mean() < 0.2
    assert processor.status == ''


def test_modes_can_be_changed_between_two_frames():
    processor, said = flown()
    assert len(view_points(said['line_params'])) == 5
    processor.configure(RunwayDetectorParameters(mode='thesis'))
    assert len(view_points(outputs(processor, 20)['line_params'])) == 3
    processor.configure(RunwayDetectorParameters(mode='approach'))
    empty = Frame(frame(21).stamp_ns, 'camera', EMPTY)
    rows = view_points(messages_of(processor, processor.process(empty))['line_params'])
    assert len(rows) == 5
    assert np.isnan(rows['rho']).all()

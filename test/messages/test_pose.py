"""What the tracker's processor makes of a pose."""

import math
from itertools import islice

import numpy as np
import pytest
from support.node_outputs import messages_of

from mvuav_ros.messages.cdr import view_points
from mvuav_ros.messages.images import Frame
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.processing.marker_processor import MarkerTrackerProcessor
from mvuav_ros.simulation.settings import TankerSettings
from mvuav_ros.simulation.tanker_flight import TankerFlight
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.marker_results import MarkerState

FLIGHT = TankerFlight(TankerSettings(motion='docking', frames=90, seed=3, failures='all@0.2-9'))
CAMERA = CameraModel(640, 480, tuple(FLIGHT.camera.matrix.ravel()))


def run(camera=CAMERA, debug=(), **parameters):
    processor = MarkerTrackerProcessor(MarkerTrackerParameters(**parameters))
    if camera is not None:
        processor.set_camera(camera)
    frames = []
    for f in islice(FLIGHT, 8):
        outputs = list(processor.process(Frame(f.stamp_ns, 'camera', f.image)))
        frames.append(messages_of(processor, [*outputs, *processor.draw(debug)]))
    return processor, frames


def numbers(pose):
    p, q = pose.pose.pose.position, pose.pose.pose.orientation
    return [p.x, p.y, p.z, q.x, q.y, q.z, q.w, *pose.pose.covariance]


def test_one_pose_for_every_frame_and_nan_without_markers():
    processor, frames = run()
    assert processor.uses_camera_info
    for index, outputs in enumerate(frames):
        pose = outputs['pose']
        assert pose.header == outputs['markers'].header
        assert pose.header.frame_id == 'camera'
        if FLIGHT.time(index) < 0.2:
            truth = FLIGHT.truth(index)
            assert numbers(pose)[:3] == pytest.approx(truth.translation, rel=0.01, abs=0.1)
            covariance = np.reshape(pose.pose.covariance, (6, 6))
            assert np.linalg.eigvalsh(covariance).min() > 0
        else:
            assert all(math.isnan(number) for number in numbers(pose))


def test_markers_that_are_lost_are_nan_and_have_no_topic():
    processor = MarkerTrackerProcessor()
    dark = Frame(1, 'camera', Image(np.zeros((48, 64), np.uint8), 'mono8'))
    outputs = messages_of(processor, processor.process(dark))
    lost = view_points(outputs['markers'])
    assert list(lost['state']) == [MarkerState.LOST] * 5 and not outputs['markers'].is_dense
    assert all(
        np.isnan(lost[name]).all() for name in ('x', 'y', 'z', 'vx', 'vy', 'ax', 'ay', 'area')
    )
    assert math.isnan(outputs['rpy'].vector.x)
    assert not any(topic.startswith('marker/') for topic in outputs)


def test_roll_stays_the_images_and_pitch_and_yaw_are_the_poses():
    _, with_pose = run()
    _, without = run(camera=None)
    for index in range(6):
        vector, plain = with_pose[index]['rpy'].vector, without[index]['rpy'].vector
        assert vector.x == plain.x
        assert vector.x == pytest.approx(FLIGHT.truth(index).roll, abs=1e-3)
        assert math.isnan(plain.y) and math.isnan(plain.z)
        relative = np.array([(0, 0, 1), (-1, 0, 0), (0, -1, 0)]) @ FLIGHT.truth(index).rotation
        assert vector.y == pytest.approx(-math.asin(relative[2, 0]), abs=0.01)
        assert vector.z == pytest.approx(math.atan2(relative[1, 0], relative[0, 0]), abs=0.01)


@pytest.mark.parametrize(
    ('camera', 'reason'),
    [
        (CameraModel(640, 480, (0.0,) * 9), 'not calibrated'),
        (CameraModel(320, 240, CAMERA.k), '320 x 240'),
    ],
)
def test_an_uncalibrated_camera_is_refused_aloud(camera, reason):
    processor, frames = run(camera=camera)
    assert reason in processor.status
    assert all(math.isnan(number) for outputs in frames for number in numbers(outputs['pose']))
    assert not math.isnan(frames[0]['rpy'].vector.x)


def test_a_wrong_calibration_withholds_the_pose_aloud_and_no_name():
    k = [1.2 * value if index in (0, 4) else value for index, value in enumerate(CAMERA.k)]
    processor, frames = run(camera=CameraModel(640, 480, tuple(k)))
    assert all(math.isnan(number) for outputs in frames for number in numbers(outputs['pose']))
    vector = frames[5]['rpy'].vector
    assert vector.x == pytest.approx(FLIGHT.truth(5).roll, abs=1e-3) and math.isnan(vector.y)
    assert 'no pose: camera_info says a focal length of' in processor.status


@pytest.mark.parametrize('given', [{'camera': None}, {'pose': False}, {'mode': 'detect_any'}])
def test_nobody_complains_where_no_pose_is_wanted_or_possible(given):
    processor, frames = run(**given)
    assert all(math.isnan(number) for outputs in frames for number in numbers(outputs['pose']))
    assert 'pose' not in processor.status


def test_the_thesiss_tracking_has_a_pose_as_well():
    _, frames = run(prediction='velocity')
    assert not math.isnan(numbers(frames[5]['pose'])[0])


def test_the_debug_image_shows_axes_and_reprojections():
    _, with_pose = run(debug=('debug_image',))
    _, without = run(debug=('debug_image',), pose=False)

    def changed(index):
        a, b = (
            np.array(f[index]['debug_image'].data).reshape(480, 640, 3)
            for f in (with_pose, without)
        )
        # The search windows, which the calibration may move by a pixel, are white.
        return (a != b).any(axis=2) & (np.ptp(a, axis=2) > 50)

    def at_dock(index):
        truth = FLIGHT.truth(index)
        dock = truth.rotation @ FLIGHT.rig.dock + truth.translation
        x, y = FLIGHT.camera.project(dock[None])[0]
        return changed(index)[round(y) - 3 : round(y) + 4, round(x) - 3 : round(x) + 4]

    assert changed(4).sum() > 100
    assert at_dock(4).any()
    # After all is lost no axes are drawn any more.
    assert not at_dock(7).any()


def test_a_new_calibration_takes_effect():
    processor = MarkerTrackerProcessor()
    distances = []
    flight = TankerFlight(TankerSettings(motion='still', frames=15))
    # One that is 2 % off might be right: a rig is not measured better.
    for factor, frame in zip(3 * [1.0] + 12 * [1.02], flight, strict=True):
        k = flight.camera.matrix.ravel().tolist()
        k[0], k[4] = factor * k[0], factor * k[4]
        processor.set_camera(CameraModel(640, 480, tuple(k)))
        given = Frame(frame.stamp_ns, 'camera', frame.image)
        outputs = messages_of(processor, processor.process(given))
        distances.append(outputs['pose'].pose.pose.position.z)
    assert distances[0] == pytest.approx(distances[2], rel=0.01)
    assert abs(distances[-1] - distances[2]) > 1.0


def statuses(frames):
    return [outputs['integrity'].status[0] for outputs in frames]


def test_integrity_in_every_frame_with_the_reason_where_there_is_none():
    _, frames = run(alert_limit=[1e4, 1e4, 1e4])
    for index, (outputs, status) in enumerate(zip(frames, statuses(frames), strict=True)):
        assert outputs['integrity'].header == outputs['pose'].header
        values = {each.key: each.value for each in status.values}
        if FLIGHT.time(index) < 0.2:
            assert (status.level, status.message) == (b'\0', 'available')
            place = outputs['pose'].pose.pose.position
            assert abs(place.z - FLIGHT.truth(index).translation[2]) < float(values['along'])
            assert values['alert_limit_along'] == '10000' and values['risk'] == '1e-07'
        else:
            assert status.level == b'\2'
            assert status.message.startswith('not available: 0 lights have a name')
            assert values['along'] == values['yaw_deg'] == 'nan'


def test_integrity_alerts_and_says_what_is_missing():
    alert = statuses(run(alert_limit=[0.0, 1e-3, 0.0])[1])[0]
    assert (alert.level, alert.message) == (b'\1', 'alert: across')
    assert statuses(run(camera=None)[1])[0].message == 'not available: no calibration'
    off = statuses(run(pose=False)[1])[0]
    assert off.message == 'not available: the parameter pose is off'
    doubted = statuses(run(light_fault_prior=0.1)[1])[0]
    assert 'too probable for the integrity risk' in doubted.message

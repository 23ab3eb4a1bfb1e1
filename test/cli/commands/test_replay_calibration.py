"""`mvuav replay --camera-info`, and rectified images: poses from any source."""

from __future__ import annotations

import struct
from dataclasses import replace
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CameraInfo, Imu
from support.commands import mvuav, mvuav_process, read, renamed

from mvuav_ros import track
from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.definitions import decode_message
from mvuav_ros.messages.images import IMAGE, serialize_image
from mvuav_ros.messages.sensors import (
    CAMERA_INFO,
    CameraInfoDecoder,
    decode_imu,
    encode_camera_info,
    encode_imu,
    stamp_ns_of,
)
from mvuav_ros.recordings.writing import RecordingWriter
from mvuav_ros.sources.calibration import save_calibration
from mvuav_ros.sources.opening import make_flight, open_source
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import Attitude
from mvuav_ros.vision.image import ImageError

POSE = '/marker_tracker/pose'
NODE = ('--nodes', 'marker_tracker')


def flight(distortion='-0.2,0.05,0,0'):
    given = {'motion': 'docking', 'frames': 12, 'start_distance': 40, 'end_distance': 30}
    return make_flight('tanker', {**given, 'distortion': distortion})


def save(path: Path, camera: CameraModel) -> Path:
    save_calibration(camera, path)
    return path


def distances(path: Path) -> list[float]:
    messages = [message for message in read(path) if message.topic == POSE]
    poses = [decode_message(m.type, m.data).pose.pose.position for m in messages]
    return [float(np.linalg.norm((p.x, p.y, p.z))) for p in poses]


@pytest.fixture(scope='module')
def truth():
    return [float(np.linalg.norm(frame.truth.translation)) for frame in flight()]


@pytest.fixture(scope='module')
def video(tmp_path_factory):
    path = tmp_path_factory.mktemp('video') / 'flight.avi'
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*'FFV1'), 30.0, (640, 480))
    for frame in flight():
        writer.write(frame.image.bgr())
    writer.release()
    return path


@pytest.fixture(scope='module')
def calibration(tmp_path_factory):
    return save(tmp_path_factory.mktemp('camera') / 'nose.yaml', flight().camera)


@pytest.mark.parametrize('jobs', [1, 2])
def test_a_video_and_a_calibration_give_poses(video, calibration, truth, tmp_path, jobs):
    out = tmp_path / 'out.mcap'
    without = tmp_path / 'without.mcap'
    assert mvuav('replay', video, '-o', without, *NODE).status == 0
    assert np.isnan(distances(without)).all()
    command = mvuav if jobs == 1 else mvuav_process
    given = ('replay', video, '-o', out, *NODE, '--camera-info', calibration)
    run = command(*given, '--jobs', jobs)
    assert run.status == 0
    # The first two frames may still be uncertain of the names.
    assert distances(out)[2:] == pytest.approx(truth[2:], rel=0.005)


def test_a_given_calibration_goes_along_with_the_inputs(video, calibration, tmp_path):
    kept, again = tmp_path / 'kept.mcap', tmp_path / 'again.mcap'
    given = (*NODE, '--keep-inputs', '--camera-info', calibration)
    assert mvuav('replay', video, '-o', kept, *given).status == 0
    assert mvuav('replay', kept, '-o', again, *NODE).status == 0
    assert np.isfinite(distances(again)).any()
    np.testing.assert_array_equal(distances(again), distances(kept))
    # One that was used does not stand beside another.
    camera = flight().camera
    other = save(tmp_path / 'other.yaml', replace(camera, k=(300, 0, 320, 0, 300, 240, 0, 0, 1)))
    given = (*NODE, '--keep-inputs', '--camera-info', other, '--force')
    assert mvuav('replay', kept, '-o', again, *given).status == 0
    infos = [decode_message(CAMERA_INFO, m.data) for m in read(again) if m.type == CAMERA_INFO]
    assert [info.k[0] for info in infos] == [300.0] * 12


def test_a_calibration_of_another_namespace_is_named_and_taken(tmp_path):
    """Without a word there were no poses, and only that there was no calibration was said."""
    flown, bag, out = (tmp_path / f'{name}.mcap' for name in ('flown', 'bag', 'out'))
    assert mvuav('replay', 'sim:tanker?frames=12', '-o', flown, *NODE, '--keep-inputs').status == 0
    renamed(flown, bag, {'/image_raw': '/cam/image_raw', '/camera_info': '/camera/camera_info'})
    hint = 'no calibration is used; --camera-info-topic names its topic: /camera/camera_info'
    silent = mvuav('replay', bag, '-o', out, *NODE)
    assert silent.status == 0 and hint in silent.err and np.isnan(distances(out)).all()
    given = ('--camera-info-topic', 'camera/camera_info', '--force')
    assert hint not in mvuav('replay', bag, '-o', out, *NODE, *given).err
    np.testing.assert_array_equal(distances(out), distances(flown))
    assert np.isfinite(distances(out)).any()


def test_the_calibration_of_a_simulated_flight_goes_along(tmp_path):
    out = tmp_path / 'out.mcap'
    assert mvuav('replay', 'sim:tanker?frames=2', '-o', out, *NODE, '--keep-inputs').status == 0
    assert [m.topic for m in read(out)].count('/camera_info') == 2


@pytest.mark.parametrize('change', [{'width': 320, 'height': 240}, {'distortion_model': 'glass'}])
def test_a_calibration_that_does_not_fit_is_refused(video, tmp_path, change):
    camera = replace(flight().camera, **change)
    out = tmp_path / 'out.mcap'
    run = mvuav('replay', video, '-o', out, '--camera-info', save(tmp_path / 'c.yaml', camera))
    assert 'camera_info is for 320 x 240 px' in run.error or "'glass' is not one of" in run.error
    assert [path.name for path in tmp_path.iterdir()] == ['c.yaml']


def test_a_file_that_is_no_calibration_is_refused(video, tmp_path):
    for name, words in (('nothing.yaml', 'No such file'), (video, 'not a calibration file')):
        run = mvuav('replay', video, '-o', tmp_path / 'out.mcap', '--camera-info', name)
        assert words in run.error


def rectified_bag(path: Path, topic: str) -> Path:
    """Undistorted images of `flight`, with the raw camera's K and d, and with P beside them."""
    raw = flight().camera
    p = np.array([(300.0, 0, 310, 0), (0, 300, 245, 0), (0, 0, 1, 0)])
    k, size = np.array(raw.k).reshape(3, 3), (640, 480)
    maps = cv2.initUndistortRectifyMap(k, np.array(raw.d), np.eye(3), p[:, :3], size, cv2.CV_32FC1)
    info_topic = f'{topic.rpartition("/")[0]}/camera_info'
    with RecordingWriter(path) as writer:
        for frame in flight():
            header = cdr_header(frame.stamp_ns, 'nose')
            info = encode_camera_info(replace(raw, p=tuple(p.ravel())), header)
            writer.write(info_topic, CAMERA_INFO, frame.stamp_ns, info)
            pixels = cv2.remap(frame.image.pixels, *maps, cv2.INTER_CUBIC)
            image = replace(frame.image, pixels=pixels)
            writer.write(topic, IMAGE, frame.stamp_ns, serialize_image(image, header))
    return path


@pytest.mark.parametrize(
    ('topic', 'more', 'is_right'),
    [
        ('/nose/image_rect', (), True),
        ('/nose/image_rect_color', (), True),
        ('/nose/image', ('--image-is-rectified',), True),
        ('/nose/image', ('--param', 'marker_tracker:image_is_rectified:=true'), True),
        # What goes wrong without: the raw camera's numbers on rectified images.
        ('/nose/image', (), False),
    ],
)
def test_rectified_images_are_seen_through_p(tmp_path, truth, topic, more, is_right):
    out = tmp_path / 'out.mcap'
    bag = rectified_bag(tmp_path / 'bag.mcap', topic)
    assert mvuav('replay', bag, '-o', out, *NODE, *more).status == 0
    found = np.array(distances(out)[2:]) / truth[2:] - 1.0
    assert (np.abs(found).max() < 0.005) == is_right


def test_a_given_calibration_is_taken_as_rectified_too(tmp_path, truth):
    out = tmp_path / 'out.mcap'
    bag = rectified_bag(tmp_path / 'bag.mcap', '/nose/image_rect')
    p = (300.0, 0, 310, 0, 0, 300, 245, 0, 0, 0, 1, 0)
    file = save(tmp_path / 'c.yaml', replace(flight().camera, p=p))
    assert mvuav('replay', bag, '-o', out, *NODE, '--camera-info', file).status == 0
    assert distances(out)[2:] == pytest.approx(truth[2:], rel=0.005)
    tracked = [
        np.linalg.norm(frame.pose.translation) for frame in islice(track(bag, file), 2, None)
    ]
    assert tracked == pytest.approx(truth[2:], rel=0.005)
    assert next(track(bag, file)).camera.matrix[0, 0] == 300.0


def test_rectified_images_stay_so_under_another_topic(tmp_path):
    """As by way of video_source, who publishes whatever it plays as image_raw."""
    bag = rectified_bag(tmp_path / 'bag.mcap', '/nose/image_rect')
    frame = next(open_source(str(bag)).frames())
    info = encode_camera_info(frame.camera, cdr_header(0, 'nose'))
    for topic in ('/image_raw', '/image_rect'):
        _, camera = CameraInfoDecoder(topic).decode(info)
        camera.check(640, 480)
        assert camera.matrix.tolist() == [[300.0, 0.0, 310.0], [0.0, 300.0, 245.0], [0, 0, 1]]
        assert camera.is_straight


def test_binning_and_the_region_of_interest_are_applied():
    k = (500.0, 0, 320, 0, 490, 240, 0, 0, 1)
    stored = encode_camera_info(CameraModel(640, 480, k), cdr_header(0, 'nose'))
    info = deserialize_message(stored, CameraInfo)
    info.binning_x = info.binning_y = 2
    info.roi.x_offset, info.roi.y_offset, info.roi.width, info.roi.height = 100, 40, 320, 400
    _, camera = CameraInfoDecoder().decode(serialize_message(info))
    camera.check(160, 200)
    assert camera.matrix[0].tolist() == [250.0, 0.0, (320 - 100 - 0.5) / 2]
    assert camera.matrix[1].tolist() == [0.0, 245.0, (240 - 40 - 0.5) / 2]
    # A region that is the whole image, and one of zero size, are none.
    info.binning_x, info.binning_y, info.roi.width, info.roi.height = 1, 0, 0, 0
    assert CameraInfoDecoder().decode(serialize_message(info))[1].matrix[0, 2] == 320.0


def test_a_calibration_that_comes_again_is_read_once():
    decoder = CameraInfoDecoder()
    camera = CameraModel(640, 480, (500.0, 0, 320, 0, 490, 240, 0, 0, 1), d=(0.1, 0, 0, 0, 0))

    def decode(camera, stamp_ns):
        return decoder.decode(encode_camera_info(camera, cdr_header(stamp_ns, 'nose')))

    one, again = decode(camera, 1_500_000_000), decode(camera, 2_000_000_000)
    assert one[0] == 1_500_000_000 and again[0] == 2_000_000_000
    assert one[1].d == camera.d and again[1] is one[1]
    assert decode(replace(camera, d=(0.2, 0, 0, 0, 0)), 3)[1].d[0] == 0.2


def test_a_damaged_calibration_or_attitude_is_refused_wherever_it_is_cut():
    camera = CameraModel(640, 480, (500.0, 0, 320, 0, 490, 240, 0, 0, 1), d=(0.1, 0, 0, 0, 0))
    header = cdr_header(1_500_000_000, 'nose')
    info = encode_camera_info(camera, header)
    imu = encode_imu(Attitude(0.0, 0.6, 0.0, 0.8, 0.1), header)
    seen = Attitude(0.0, 0.6, 0.0, 0.8, pytest.approx(0.1), sensor='nose')
    assert decode_imu(imu) == (1_500_000_000, seen)
    for axis in (0, 4):
        uneven = bytearray(imu)
        struct.pack_into('<d', uneven, len(imu) - (33 - axis) * 8, 0.09)
        assert decode_imu(bytes(uneven))[1].sigma == pytest.approx(0.3)
    # Of a calibration the last byte and what fills up its word are not needed.
    for decode, data in ((CameraInfoDecoder().decode, info[:-4]), (decode_imu, imu)):
        for length in range(len(data)):
            with pytest.raises(ImageError):
                decode(data[:length])
    count = info.index(b'plumb_bob') + 12
    assert info[count : count + 4] == b'\x05\0\0\0'
    with pytest.raises(ImageError):
        CameraInfoDecoder().decode(info[:count] + b'\xff\xff\xff\xff' + info[count + 4 :])


def test_a_calibration_and_an_attitude_are_what_rclpy_takes_them_for():
    camera = CameraModel(640, 480, (500.0, 0, 320, 0, 490, 240, 0, 0, 1), d=(0.1, 0, 0, 0.2))
    for frame_id in ('', 'nose', 'noses'):
        header = cdr_header(1_500_000_000, frame_id)
        info = deserialize_message(encode_camera_info(camera, header), CameraInfo)
        seen = Attitude(0.0, 0.6, 0.0, 0.8, 0.1)
        imu = deserialize_message(encode_imu(seen, header), Imu)
        for message in (info, imu):
            assert message.header.frame_id == frame_id
            assert stamp_ns_of(message.header) == 1_500_000_000
        p = (500.0, 0.0, 320.0, 0.0, 0.0, 490.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0)
        assert (info.width, info.height, info.distortion_model) == (640, 480, 'plumb_bob')
        assert (*info.d,) == camera.d and (*info.k,) == camera.k and (*info.p,) == p
        assert np.reshape(info.r, (3, 3)).tolist() == np.eye(3).tolist()
        assert (info.binning_x, info.roi.width, info.roi.do_rectify) == (0, 0, False)
        assert (imu.orientation.y, imu.orientation.w) == (0.6, 0.8)
        variances = np.diag(np.reshape(imu.orientation_covariance, (3, 3)))
        assert variances.tolist() == pytest.approx([0.01] * 3)
        assert imu.angular_velocity_covariance[0] == imu.linear_acceleration_covariance[0] == -1.0

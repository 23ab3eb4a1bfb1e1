"""The camera's mount of a recording's ``/tf_static``, as live nodes have it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from support.commands import mvuav, read
from support.places import ROOT
from support.recording_samples import STORE, cdr

from mvuav_ros.messages.definitions import decode_message
from mvuav_ros.messages.poses import TF, TF_STATIC_TOPIC
from mvuav_ros.recordings.writing import RecordingWriter
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, from_rpy, quaternion

XYZ, PITCH_DEG = (0.8, 0.1, -0.2), 20.0
POSE = '/marker_tracker/vision_pose'
BASE = ('--nodes', 'marker_tracker', '--param', 'marker_tracker:base_frame:=base_link')


def mount(frame_id: str) -> bytes:
    """A TFMessage: where the camera's optical frame is on the vehicle."""
    types = STORE.types
    turn = from_rpy(0.0, math.radians(PITCH_DEG), 0.0) @ OPTICAL_FROM_BODY.T
    stamp = types['builtin_interfaces/msg/Time'](0, 0)
    transform = types['geometry_msgs/msg/Transform'](
        types['geometry_msgs/msg/Vector3'](*XYZ),
        types['geometry_msgs/msg/Quaternion'](*quaternion(turn)),
    )
    header = types['std_msgs/msg/Header'](stamp, 'base_link')
    stamped = types['geometry_msgs/msg/TransformStamped'](header, frame_id, transform)
    return cdr(types[TF]([stamped]))


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    """The sample bag; the mount is published once, after ten images."""
    path, images = tmp_path / 'flight.mcap', 0
    with RecordingWriter(path) as writer:
        for message in read(Path(ROOT) / 'bags' / 'tanker.mcap'):
            writer.write(message.topic, message.type, message.stamp_ns, message.data)
            images += message.topic.endswith('image_raw')
            if images == 10 and message.topic.endswith('image_raw'):
                frame_id = decode_message(message.type, message.data).header.frame_id
                writer.write(TF_STATIC_TOPIC, TF, message.stamp_ns, mount(frame_id))
    return path


def poses(path: Path) -> dict[int, np.ndarray]:
    found = {}
    for message in read(path):
        if message.topic == POSE:
            pose = decode_message(message.type, message.data).pose
            p, q = pose.pose.position, pose.pose.orientation
            numbers = (p.x, p.y, p.z, q.x, q.y, q.z, q.w, *pose.covariance)
            found[message.stamp_ns] = np.array(numbers)
    return found


def test_the_vehicles_pose_is_that_of_the_mount(flight: Path, tmp_path: Path) -> None:
    """A replay wrote none, where live nodes published it."""
    given = tmp_path / 'given.mcap'
    options = ['--param', f'marker_tracker:camera_mount_xyz:={list(XYZ)}', '--param']
    options += [f'marker_tracker:camera_mount_rpy_deg:=[0.0, {PITCH_DEG}, 0.0]']
    assert mvuav('replay', flight, '-o', given, *BASE, *options).status == 0
    expected = poses(given)
    late = sorted(expected)[10:]
    assert len(late) > 100
    for selection in ([], ['--start', '2', '--jobs', '2'], ['--start', '2', '--keep-inputs']):
        out = tmp_path / 'out.mcap'
        done = mvuav('replay', flight, '-o', out, '--force', *BASE, *selection)
        assert done.status == 0
        found = poses(out)
        # Of a part the tracker begins later; its poses are others by a little.
        assert len(found) > 80 and (selection or list(found) == late)
        for stamp, pose in found.items():
            assert pose[:7] == pytest.approx(expected[stamp][:7], abs=0.05 if selection else 1e-9)
        assert 'vision_pose' not in done.err
    nowhere = Path(ROOT) / 'bags' / 'tanker.mcap'
    done = mvuav('replay', nowhere, '-o', out, '--force', *BASE)
    assert 'note: marker_tracker, every frame: no ~/vision_pose of base_link' in done.err

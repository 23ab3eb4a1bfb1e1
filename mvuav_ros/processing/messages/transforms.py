"""Where camera and target are to each other, as ``/tf`` and ``~/vision_pose`` carry it.

``/tf`` goes from the camera's optical frame to the target (a marker does so too), as the camera
already has a parent on a robot that describes itself. ``~/vision_pose`` is the other way round: the
camera's body axes (x forward, y left, z up, REP-103) in the target's frame.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.recordings.serialization.cdr import (
    CdrWriter,
    stamped_doubles,
    without_encapsulation,
)
from mvuav_ros.vision.approach.results import Guidance
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, from_rpy, quaternion
from mvuav_ros.vision.pose import Pose

Array = NDArray[np.float64]

TF_TOPIC = '/tf'
TF_TYPE: Any = None
"""The message of ``/tf``; None where tf2_msgs is not installed."""
if importlib.util.find_spec('tf2_msgs') is not None:
    TF_TYPE = importlib.import_module('tf2_msgs.msg').TFMessage


@dataclass(frozen=True, eq=False)
class Placement:
    """A frame seen from another one.

    Attributes:
        rotation: (3, 3), outer from inner axes.
        translation: (3,), m, of the inner origin.
        covariance: (6, 6), of the translation (m) and of small turns about the outer axes (rad).
    """

    rotation: Array
    translation: Array
    covariance: Array

    @property
    def known(self) -> bool:
        """Whether all of it is."""
        return bool(np.isfinite(self.translation).all() and np.isfinite(self.rotation).all())


def body_in_camera(pose: Pose) -> Placement:
    """The body in the camera's optical frame."""
    return Placement(pose.rotation, pose.translation, pose.covariance)


def camera_in_runway(guidance: Guidance) -> Placement:
    """The camera's body axes in the runway's frame; NaN where guidance is."""
    position = np.array([guidance.x, guidance.y, guidance.z])
    rotation = from_rpy(guidance.roll, guidance.pitch, guidance.yaw)
    return Placement(rotation, position, guidance.covariance)


def runway_in_camera(guidance: Guidance) -> Placement:
    """The runway's frame in the camera's optical frame; NaN where guidance is."""
    rotation = OPTICAL_FROM_BODY @ from_rpy(guidance.roll, guidance.pitch, guidance.yaw).T
    position = np.array([guidance.x, guidance.y, guidance.z])
    return Placement(rotation, -rotation @ position, np.full((6, 6), math.nan))


def camera_in_body(pose: Pose) -> Placement:
    """The camera's body axes in the frame of a body that has that pose before it."""
    inverse = pose.rotation.T
    x, y, z = pose.translation
    cross = np.array([(0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)])
    # A small turn w about the optical axes moves the position by -Rᵀ [t]ₓ w, turns by -Rᵀ w.
    jacobian = np.block([[-inverse, -inverse @ cross], [np.zeros((3, 3)), -inverse]])
    return Placement(
        inverse @ OPTICAL_FROM_BODY,
        -inverse @ pose.translation,
        jacobian @ pose.covariance @ jacobian.T,
    )


def encode_transform(placement: Placement, header: bytes, child_frame: str) -> bytes:
    """A TFMessage with one transform: the placement of the child in the header's frame."""
    writer = CdrWriter()
    transforms = 1
    writer.numbers('I', transforms)
    writer.written(without_encapsulation(header))
    writer.text(child_frame)
    writer.numbers('7d', *placement.translation.tolist(), *quaternion(placement.rotation))
    return writer.message()


def encode_placement(placement: Placement, header: bytes) -> bytes:
    """A PoseWithCovarianceStamped in the header's frame."""
    pose = (*placement.translation.tolist(), *quaternion(placement.rotation))
    return stamped_doubles(header, *pose, *placement.covariance.ravel().tolist())


def encode_pose(pose: Pose | None, header: bytes) -> bytes:
    """A PoseWithCovarianceStamped: the body in the camera's optical frame (m, rad).

    All NaN where there is no pose.
    """
    if pose is not None:
        return encode_placement(body_in_camera(pose), header)
    return stamped_doubles(header, *[math.nan] * 43)

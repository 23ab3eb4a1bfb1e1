"""Where camera and target are to each other, and how wrong that may be.

Body axes are x forward, y left, z up (REP-103).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.messages.cdr import (
    ERROR,
    OK,
    WARN,
    CdrWriter,
    Status,
    behind_header,
    stamped_doubles,
    status_fields,
    texts,
    without_encapsulation,
)
from mvuav_ros.parameters.common_parameters import PosedParameters
from mvuav_ros.vision.approach.approach_results import Guidance
from mvuav_ros.vision.frames import (
    OPTICAL_FROM_BODY,
    about_z,
    from_quaternion,
    from_rpy,
    quaternion,
)
from mvuav_ros.vision.integrity import IntegrityState, Levels, integrity_state
from mvuav_ros.vision.pose import Pose

Array = NDArray[np.float64]

TF = 'tf2_msgs/msg/TFMessage'
TF_TOPIC, TF_STATIC_TOPIC = '/tf', '/tf_static'
TF_TYPE: Any = None
"""The message of ``/tf``; None where tf2_msgs is not installed."""
with suppress(ModuleNotFoundError):
    from tf2_msgs.msg import TFMessage

    TF_TYPE = TFMessage

_UNKNOWN = np.full((6, 6), math.nan)


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
    def inverse(self) -> Placement:
        """The outer frame seen from the inner one; without covariance."""
        turned = self.rotation.T
        return Placement(turned, -turned @ self.translation, _UNKNOWN)

    @property
    def known(self) -> bool:
        """Whether all of it is."""
        return bool(np.isfinite(self.translation).all() and np.isfinite(self.rotation).all())


def vehicle_of(camera: Placement, mount: Placement) -> Placement:
    """The vehicle that carries a camera, in the frame that the camera's body axes are given in.

    ``mount`` has these axes on the vehicle.
    """
    rotation = camera.rotation @ mount.rotation.T
    arm = rotation @ mount.translation
    jacobian = np.eye(6)
    # A small turn w about the outer axes moves the vehicle by arm x w.
    jacobian[:3, 3:] = _cross(arm)
    covariance = jacobian @ camera.covariance @ jacobian.T
    return Placement(rotation, camera.translation - arm, covariance)


def mount_of(xyz: tuple[float, ...], rpy_deg: tuple[float, ...]) -> Placement:
    """A camera's body axes on the vehicle, from its position (m) and angles (degrees)."""
    roll, pitch, yaw = map(math.radians, rpy_deg)
    return Placement(from_rpy(roll, pitch, yaw), np.array(xyz), _UNKNOWN)


_UPWARDS = 0.8  # Cosine off the vehicle's z


def mount_on_vehicle(
    given: PosedParameters, frame_id: str, transforms: TransformTree
) -> tuple[Placement | None, bool]:
    """The camera's body axes on the vehicle, as the parameters state them or ``/tf_static`` does.

    And whether the frame by which that knows the camera seems not to be an optical one.
    """
    stated = given.camera_mount_xyz, given.camera_mount_rpy_deg
    if any(map(any, stated)):
        return mount_of(*stated), False
    name = camera_frame_of(given, frame_id)
    found = transforms.find(name, given.base_frame)
    if found is None:
        return None, False
    # Many drivers call it "camera", as robot descriptions do a frame with z up.
    looks_up = 'optical' not in name and found.rotation[2, 2] > _UPWARDS
    return replace(found, rotation=found.rotation @ OPTICAL_FROM_BODY), bool(looks_up)


def camera_frame_of(given: PosedParameters, frame_id: str) -> str:
    """The frame of a camera whose images have a frame_id."""
    # tf2 takes neither a frame without a name nor one that begins with a slash.
    return given.camera_frame or frame_id.lstrip('/')


_MAX_OFF_UNIT = 0.005
"""Of a quaternion's length, about what tf2 has."""


class TransformTree:
    """The transforms of ``/tf_static``: each frame in its parent, the newest parent counting."""

    def __init__(self) -> None:
        self._placed: dict[str, tuple[str, Placement]] = {}

    def add(self, message: Any) -> None:
        """Take in a tf2_msgs/TFMessage, as tf2 does: without slashes in front, and what is one."""
        for each in message.transforms:
            q, t = each.transform.rotation, each.transform.translation
            turn, place = (q.x, q.y, q.z, q.w), np.array([t.x, t.y, t.z])
            is_unit = abs(math.hypot(*turn) - 1.0) < _MAX_OFF_UNIT
            if is_unit and np.isfinite(place).all():
                placed = Placement(from_quaternion(*turn), place, _UNKNOWN)
                parent, child = each.header.frame_id.lstrip('/'), each.child_frame_id.lstrip('/')
                self._placed[child] = parent, placed

    def parent(self, frame: str) -> str:
        """The frame's parent; empty where it has none."""
        return self._placed[frame][0] if frame in self._placed else ''

    def find(self, inner: str, outer: str) -> Placement | None:
        """A frame in one of its ancestors; None where they are not so connected."""
        found = Placement(np.eye(3), np.zeros(3), _UNKNOWN)
        for _ in self._placed:
            if inner == outer or inner not in self._placed:
                break
            inner, placed = self._placed[inner]
            moved = placed.rotation @ found.translation + placed.translation
            found = Placement(placed.rotation @ found.rotation, moved, _UNKNOWN)
        return found if inner == outer else None


def body_in_camera(pose: Pose) -> Placement:
    """The body in the camera's optical frame."""
    return Placement(pose.rotation, pose.translation, pose.covariance)


def camera_in_runway(guidance: Guidance) -> Placement:
    """The camera's body axes in the runway's frame; NaN where guidance is."""
    position = np.array([guidance.x, guidance.y, guidance.z])
    rotation = from_rpy(guidance.roll, guidance.pitch, guidance.yaw)
    jacobian = np.eye(6)
    # Roll and pitch turn about axes that the later angles have turned, not about the runway's.
    jacobian[3:, 3], jacobian[3:, 4] = rotation[:, 0], about_z(guidance.yaw)[:, 1]
    return Placement(rotation, position, jacobian @ guidance.covariance @ jacobian.T)


def camera_in_body(pose: Pose) -> Placement:
    """The camera's body axes in the frame of a body that has that pose before it."""
    inverse = pose.rotation.T
    jacobian = np.zeros((6, 6))
    # A small turn w about the optical axes moves the position by -Rᵀ [t]ₓ w, turns by -Rᵀ w.
    jacobian[:3, :3] = jacobian[3:, 3:] = -inverse
    jacobian[:3, 3:] = -inverse @ _cross(pose.translation)
    return Placement(
        inverse @ OPTICAL_FROM_BODY,
        -inverse @ pose.translation,
        jacobian @ pose.covariance @ jacobian.T,
    )


def _cross(vector: Array) -> Array:
    """The matrix whose product with w is the cross product of the vector with w."""
    x, y, z = vector.tolist()
    return np.array([(0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)])


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


def encode_integrity(
    levels: Levels, alert_limits: Sequence[float], risk: float, header: bytes
) -> bytes:
    """A DiagnosticArray with one status: OK available, WARN alert, ERROR not available.

    Its values are the levels (m; degrees where the key says so), the alert limits and the
    integrity risk per frame.
    """
    return behind_header(header, _integrity_fields(levels, tuple(alert_limits), risk))


# Where there are no levels every frame says the same.
@lru_cache(maxsize=16)
def _integrity_fields(levels: Levels, alert_limits: tuple[float, ...], risk: float) -> bytes:
    state = integrity_state(levels, alert_limits)
    message = state.name.lower().replace('_', ' ')
    if reason := levels.reason or ', '.join(levels.beyond(alert_limits)):
        message += f': {reason}'
    values = texts(**levels.named)
    for axis, limit in zip(levels.limited, alert_limits, strict=True):
        values[f'alert_limit_{axis}'] = f'{limit:g}' if limit else 'none'
    values['risk'] = f'{risk:g}'
    return status_fields([Status(_LEVELS[state], levels.subject, message, values)])


_LEVELS = {
    IntegrityState.AVAILABLE: OK,
    IntegrityState.ALERT: WARN,
    IntegrityState.NOT_AVAILABLE: ERROR,
}

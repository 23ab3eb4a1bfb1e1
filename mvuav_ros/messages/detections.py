"""Results as vision_msgs: ``~/detections`` and ``~/detections_3d``, where that is installed.

What stands in the PointCloud2 rows and in ``~/pose``, for viewers and trackers that know neither.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from mvuav_ros.messages.cdr import CdrWriter, without_encapsulation
from mvuav_ros.vision.approach.approach_results import ApproachResult
from mvuav_ros.vision.frames import quaternion
from mvuav_ros.vision.markers.marker_results import MarkerResult, MarkerState
from mvuav_ros.vision.pose import Pose
from mvuav_ros.vision.rig import MarkerRig

TYPES: dict[str, Any] = {}
"""Topics and their messages; none where vision_msgs is not installed."""
with suppress(ModuleNotFoundError):
    from vision_msgs.msg import Detection2DArray, Detection3DArray

    TYPES = {'detections': Detection2DArray, 'detections_3d': Detection3DArray}
_NO_POSE = (math.nan,) * 43


_Found = list[tuple[str, float, tuple[float, float, float, float]]]
"""What was found in an image: its name, its probability, and its box (x, y, width, height; px)."""


def encode_markers(result: MarkerResult, names: Sequence[str], header: bytes) -> bytes:
    """A Detection2DArray: the markers measured in this image, each as the square of its area.

    A name is given only where it is not in doubt: its score is 1. A light without a name is
    called ``light``, with its number in ``track_any``.
    """
    found: _Found = []
    for index, marker in enumerate(result.markers):
        if marker.state is MarkerState.DETECTED:
            name = f'light_{result.ids[index]}' if result.ids else 'light'
            name = names[marker.label] if marker.label < len(names) else name
            side = math.sqrt(marker.area)
            found.append((name, 1.0, (marker.x, marker.y, side, side)))
    return _encode(found, header)


def encode_runway(result: Any, target: str, header: bytes) -> bytes:
    """A Detection2DArray: what mode ``approach`` found, around its corners, with its confidence."""
    if not isinstance(result, ApproachResult) or result.corners is None:
        return _encode([], header)
    xs, ys = zip(*result.corners, strict=True)
    left, right, top, bottom = min(xs), max(xs), min(ys), max(ys)
    box = (left + right) / 2, (top + bottom) / 2, right - left, bottom - top
    return _encode([(target, result.confidence, box)], header)


def encode_body(rig: MarkerRig, pose: Pose | None, header: bytes) -> bytes:
    """A Detection3DArray: the body in the camera's optical frame, in the box around its markers.

    Empty without a pose, and with a score of 1, as a pose in doubt is withheld.
    """
    writer = CdrWriter(header)
    writer.numbers('I', pose is not None)
    if pose is not None:
        low, high = rig.positions.min(axis=0), rig.positions.max(axis=0)
        turn = quaternion(pose.rotation)
        covariance = pose.covariance.ravel().tolist()
        _begin(writer, header, rig.name, 1.0, (*pose.translation.tolist(), *turn, *covariance))
        centre = pose.rotation @ ((low + high) / 2) + pose.translation
        writer.numbers('10d', *centre.tolist(), *turn, *(high - low).tolist())
        writer.text(rig.name)
    return writer.message()


def _encode(found: _Found, header: bytes) -> bytes:
    """A Detection2DArray: one hypothesis each, whose pose is not known (NaN)."""
    writer = CdrWriter(header)
    writer.numbers('I', len(found))
    for name, score, (x, y, width, height) in found:
        _begin(writer, header, name, score, _NO_POSE)
        theta = 0.0
        writer.numbers('5d', x, y, theta, width, height)
        writer.text(name)
    return writer.message()


def _begin(
    writer: CdrWriter, header: bytes, name: str, score: float, pose: Sequence[float]
) -> None:
    hypotheses = 1
    writer.written(without_encapsulation(header))
    writer.numbers('I', hypotheses)
    writer.text(name)
    writer.numbers('44d', score, *pose)

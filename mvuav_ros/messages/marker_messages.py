"""Marker results as messages: ``~/markers``, ``~/marker/<label>`` and ``~/rpy``."""

from __future__ import annotations

import math
import re

import numpy as np

from mvuav_ros.messages.cdr import PointLayout, stamped_doubles
from mvuav_ros.vision.markers.marker_results import Marker, MarkerResult
from mvuav_ros.vision.pose import Pose
from mvuav_ros.vision.rig import MarkerRig

_PLACE = [(name, np.float32) for name in ('x', 'y', 'z', 'vx', 'vy', 'ax', 'ay', 'area')]
_NAME = [('label', np.uint8), ('state', np.uint8)]
POINT = np.dtype([*_PLACE, *_NAME, ('confidence', np.float32)])
_POINTS = PointLayout(POINT)
NUMBERED_POINT = np.dtype([*_PLACE, *_NAME, ('id', np.float32), ('confidence', np.float32)])
"""Rows of ``track_any``: with the light's number, exact up to 16 million."""
_NUMBERED_POINTS = PointLayout(NUMBERED_POINT)
_TOPIC_WORD = re.compile(r'[A-Za-z]\w*', re.ASCII)


def refused_names(rig: MarkerRig) -> list[str]:
    """Why markers cannot have the topics of their names: a line for each such name."""
    why = 'cannot be part of a topic: only a letter, then A-Z a-z 0-9 _'
    return [f'{name!r} {why}' for name in rig.names if not _TOPIC_WORD.fullmatch(name)]


def encode_markers(result: MarkerResult, header: bytes, *, numbered: bool = False) -> bytes:
    """A PointCloud2: every marker as one point, px, px/s, px/s², label, state, and confidence.

    In ``track_any`` each row has the light's number too. Like all results it is in CDR and begins
    with a `cdr_header`.
    """
    rows = [
        (m.x, m.y, m.x * 0.0, m.vx, m.vy, m.ax, m.ay, m.area, m.label, m.state, m.confidence)
        for m in result.markers
    ]
    if numbered:
        numbers = [
            (*row[:-1], number, row[-1]) for row, number in zip(rows, result.ids, strict=True)
        ]
        return _NUMBERED_POINTS.encode(numbers, header)
    return _POINTS.encode(rows, header)


def encode_marker(marker: Marker, header: bytes) -> bytes:
    """A PointStamped: one marker's position, px."""
    return stamped_doubles(header, marker.x, marker.y, 0.0)


def encode_rpy(result: MarkerResult, header: bytes, pose: Pose | None = None) -> bytes:
    """A Vector3Stamped: roll, pitch and yaw (rad).

    x is the roll in the image where the body has wings, as without a pose; else the pose's. y
    and z are the pose's pitch and yaw, NaN without one.
    """
    roll, pitch, yaw = pose.rpy if pose is not None else (math.nan, math.nan, math.nan)
    if result.has_wings:
        roll = float(result.roll)
    return stamped_doubles(header, roll, pitch, yaw)

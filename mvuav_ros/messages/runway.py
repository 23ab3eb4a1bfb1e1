"""Runway results as messages: lines as points, as a marker and as diagnostics; statistics."""

from __future__ import annotations

import math

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, PointStamped, PoseWithCovarianceStamped
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from mvuav_ros.messages.points import encode_points, point_fields
from mvuav_ros.vision.approach.model import ApproachResult, Guidance
from mvuav_ros.vision.approach.overlay import ROLE_COLORS
from mvuav_ros.vision.runway.model import LineRole, RunwayLine, RunwayResult
from mvuav_ros.vision.runway.overlay import line_color
from mvuav_ros.vision.runway.statistics import LineSummary, RunwaySummary

_FLOATS = ('x', 'y', 'z', 'x2', 'y2', 'rho', 'theta', 'votes', 'rho_raw', 'theta_raw')
# Later fields stand behind the earlier ones, whose offsets stay; a float is aligned to its size.
_NAMES = (*_FLOATS, 'flags', 'role', 'confidence')
LINE = np.dtype(
    {
        'names': _NAMES,
        'formats': [*[np.float32] * len(_FLOATS), np.uint8, np.uint8, np.float32],
        'offsets': [*range(0, 4 * len(_FLOATS), 4), 40, 41, 44],
        'itemsize': 48,
    }
)
_FIELDS = point_fields(LINE)
LINE_WIDTH = 2.0
"""Px, of ``~/lines``."""


Result = RunwayResult | ApproachResult


def encode_line_params(result: Result, header: Header) -> PointCloud2:
    """Every row: px and rad on the whole frame, votes and flags; NaN where no line was found."""
    # Field by field into zeros: whole rows would leave chance bytes between the fields.
    lines = np.zeros(len(result.lines), LINE)
    columns = zip(*(_values(line) for line in result.lines), strict=True)
    for name, column in zip(_NAMES, columns, strict=True):
        lines[name] = column
    return encode_points(lines, _FIELDS, header)


def _values(line: RunwayLine) -> tuple[float | int, ...]:
    return (
        line.x,
        line.y,
        line.x * 0.0,
        line.x2,
        line.y2,
        line.rho,
        line.theta,
        line.votes,
        line.rho_raw,
        line.theta_raw,
        int(line.flags),
        int(line.role),
        line.confidence,
    )


def encode_lines(result: Result, header: Header) -> Marker:
    """The segments as a LINE_LIST, coloured by role, or by flag where roles are not known.

    Without any, the marker is deleted.
    """
    marker = Marker(header=header, ns='runway', id=0, type=Marker.LINE_LIST)
    marker.pose.orientation.w = 1.0
    marker.scale.x = LINE_WIDTH
    for line in result.lines:
        # A line may be known and yet miss the frame.
        if math.isnan(line.x):
            continue
        blue, green, red = (value / 255 for value in _color(line))
        color = ColorRGBA(r=red, g=green, b=blue, a=1.0)
        marker.points += [Point(x=line.x, y=line.y), Point(x=line.x2, y=line.y2)]
        marker.colors += [color, color]
    marker.action = Marker.ADD if marker.points else Marker.DELETE
    return marker


def _color(line: RunwayLine) -> tuple[int, int, int]:
    if line.role is LineRole.UNKNOWN:
        return line_color(line.flags)
    return ROLE_COLORS[line.role]


def encode_vanishing_point(result: Result, header: Header) -> PointStamped:
    """Where the edges meet, px, z = 0; NaN while that is not known."""
    message = PointStamped(header=header)
    point = message.point
    point.x, point.y, point.z = math.nan, math.nan, math.nan
    if isinstance(result, ApproachResult) and not math.isnan(result.vanishing_point[0]):
        (point.x, point.y), point.z = result.vanishing_point, 0.0
    return message


def encode_pose(guidance: Guidance, header: Header) -> PoseWithCovarianceStamped:
    """The camera in the runway's frame; NaN with a huge variance where it is not known.

    The orientation is that of the camera's body axes (x forward, y left, z up).
    """
    message = PoseWithCovarianceStamped(header=header)
    pose = message.pose.pose
    pose.position.x, pose.position.y, pose.position.z = guidance.x, guidance.y, guidance.z
    cr, sr = math.cos(0.5 * guidance.roll), math.sin(0.5 * guidance.roll)
    cp, sp = math.cos(0.5 * guidance.pitch), math.sin(0.5 * guidance.pitch)
    cy, sy = math.cos(0.5 * guidance.yaw), math.sin(0.5 * guidance.yaw)
    pose.orientation.x = sr * cp * cy - cr * sp * sy
    pose.orientation.y = cr * sp * cy + sr * cp * sy
    pose.orientation.z = cr * cp * sy - sr * sp * cy
    pose.orientation.w = cr * cp * cy + sr * sp * sy
    message.pose.covariance = guidance.covariance.ravel().tolist()
    return message


def encode_corrections(result: Result, header: Header) -> DiagnosticArray:
    """One status per row, for ``ros2 topic echo``."""
    return DiagnosticArray(
        header=header,
        status=[_correction(index, line) for index, line in enumerate(result.lines)],
    )


def _correction(index: int, line: RunwayLine) -> DiagnosticStatus:
    if not line.found:
        message = 'not found'
    elif line.corrected:
        message = 'corrected: the old values are kept'
    else:
        message = 'ok'
    return DiagnosticStatus(
        level=DiagnosticStatus.OK if message == 'ok' else DiagnosticStatus.WARN,
        name=_name(index, line),
        message=message,
        values=_key_values(
            rho=line.rho,
            theta_deg=math.degrees(line.theta),
            rho_flag=line.rho_flag,
            theta_flag=line.theta_flag,
            corrected=line.corrected,
        ),
    )


def _name(index: int, line: RunwayLine) -> str:
    if line.role is LineRole.UNKNOWN:
        return f'line {index}'
    return f'line {index} ({line.role.name.lower()})'


def encode_statistics(summary: RunwaySummary, header: Header) -> DiagnosticArray:
    """The GUI's result section: totals first, then one status per line."""
    total = DiagnosticStatus(
        level=DiagnosticStatus.OK,
        name='runway',
        message=f'{summary.frames} frames',
        values=_key_values(
            frames=summary.frames,
            rho_flags=summary.rho_flags,
            theta_flags=summary.theta_flags,
            combined_flags=summary.corrected,
        ),
    )
    lines = [_line_statistics(index, line) for index, line in enumerate(summary.lines)]
    return DiagnosticArray(header=header, status=[total, *lines])


def _line_statistics(index: int, line: LineSummary) -> DiagnosticStatus:
    return DiagnosticStatus(
        level=DiagnosticStatus.OK,
        name=f'line {index}',
        message=f'found in {line.found} frames',
        values=_key_values(
            found=line.found,
            rho_flags=line.rho_flags,
            theta_flags=line.theta_flags,
            combined_flags=line.corrected,
            rho_mean=line.rho_mean,
            rho_std=line.rho_std,
            theta_mean_deg=math.degrees(line.theta_mean),
            theta_std_deg=math.degrees(line.theta_std),
        ),
    )


def _key_values(**values: float | bool) -> list[KeyValue]:
    return [KeyValue(key=key, value=_text(value)) for key, value in values.items()]


def _text(value: float | bool) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'{value:.4f}' if isinstance(value, float) else str(value)

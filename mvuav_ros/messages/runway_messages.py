"""Runway results as messages: lines as points, as a marker and as diagnostics; statistics."""

from __future__ import annotations

import math

import numpy as np

from mvuav_ros.messages.cdr import (
    OK,
    WARN,
    CdrWriter,
    PointLayout,
    Status,
    behind_header,
    stamped_doubles,
    status_fields,
    texts,
)
from mvuav_ros.vision.approach.approach_results import ApproachResult, Guidance
from mvuav_ros.vision.approach.overlay import ROLE_COLORS
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import from_rpy, quaternion
from mvuav_ros.vision.runway.debug_images import line_color
from mvuav_ros.vision.runway.results import LineRole, RunwayLine, RunwayResult
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
_LINES = PointLayout(LINE)
LINE_WIDTH = 2.0
"""Px, of ``~/lines``."""
PLANE = 1.0
"""m ahead of a calibrated camera, where ``~/lines`` are drawn."""
_LINE_LIST, _ADD, _DELETE = 5, 0, 2
"""Of visualization_msgs/Marker."""
_NO_COLOR_LIFETIME_AND_LOCK = bytes(4 * 4 + 2 * 4 + 1)
_NO_TEXT = b'\1' + bytes(7)  # its length with the end sign, and up to the next whole word
_NO_TEXTURE = _NO_TEXT + bytes(8) + 2 * _NO_TEXT + bytes(4)  # name; stamp, frame, format, data
# Behind the texture: uv_coordinates; text, mesh and its file's name; data, materials.
_NO_TEXTURE_TEXT_AND_MESH = _NO_TEXTURE + bytes(4) + 3 * _NO_TEXT + bytes(4 + 1)

Result = RunwayResult | ApproachResult


def encode_line_params(result: Result, header: bytes) -> bytes:
    """A PointCloud2: px and rad on the whole frame, votes and flags; NaN where no line was found.

    Like all results it is in CDR and begins with a `cdr_header`.
    """
    rows = [
        (
            *(line.x, line.y, line.x * 0.0, line.x2, line.y2),
            *(line.rho, line.theta, line.votes, line.rho_raw, line.theta_raw),
            *(int(line.flags), int(line.role), line.confidence),
        )
        for line in result.lines
    ]
    return _LINES.encode(rows, header)


def encode_lines(result: Result, header: bytes, camera: CameraModel | None = None) -> bytes:
    """A Marker: the segments as a LINE_LIST, coloured by role, or by flag without roles.

    Without any, the marker is deleted. With the frame's calibration the segments lie on the plane
    at `PLANE`, m in the optical frame, and overlay the image in RViz; without it they are px,
    z = 0.
    """
    # A line may be known and yet miss the frame.
    drawn = [line for line in result.lines if not math.isnan(line.x)]
    ends = [point for line in drawn for point in ((line.x, line.y), (line.x2, line.y2))]
    points, width, depth = ends, LINE_WIDTH, 0.0
    if camera is not None:
        flat = camera.undistort(ends).tolist() if ends else []
        points = [(x * PLANE, y * PLANE) for x, y in flat]
        width, depth = LINE_WIDTH / camera.matrix[0, 0] * PLANE, PLANE
    colors: list[float] = []
    for line in drawn:
        has_role = line.role is not LineRole.UNKNOWN
        color = ROLE_COLORS[line.role] if has_role else line_color(line.flags)
        blue, green, red = (value / 255 for value in color)
        colors += 2 * (red, green, blue, 1.0)
    number, action = 0, _ADD if points else _DELETE
    writer = CdrWriter(header)
    writer.text('runway')
    writer.numbers('3i', number, _LINE_LIST, action)
    position, orientation, scale = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), (width, 0.0, 0.0)
    writer.numbers('10d', *position, *orientation, *scale)
    writer.written(_NO_COLOR_LIFETIME_AND_LOCK)
    writer.numbers('I', len(points))
    writer.numbers(f'{3 * len(points)}d', *(each for x, y in points for each in (x, y, depth)))
    writer.numbers('I', len(colors) // 4)
    writer.numbers(f'{len(colors)}f', *colors)
    writer.written(_NO_TEXTURE_TEXT_AND_MESH)
    return writer.message()


def encode_vanishing_point(result: Result, header: bytes) -> bytes:
    """A PointStamped: where the edges meet, px, z = 0; NaN while that is not known."""
    x = y = z = math.nan
    if isinstance(result, ApproachResult) and not math.isnan(result.vanishing_point[0]):
        (x, y), z = result.vanishing_point, 0.0
    return stamped_doubles(header, x, y, z)


def encode_pose(guidance: Guidance, header: bytes) -> bytes:
    """A PoseWithCovarianceStamped: the camera in the runway's frame, which the header names.

    NaN with a huge variance where it is not known. The orientation is that of the camera's body
    axes (x forward, y left, z up).
    """
    turn = quaternion(from_rpy(guidance.roll, guidance.pitch, guidance.yaw))
    covariance = guidance.covariance.ravel().tolist()
    return stamped_doubles(header, guidance.x, guidance.y, guidance.z, *turn, *covariance)


def encode_corrections(result: Result, header: bytes) -> bytes:
    """A DiagnosticArray: one status per row, for ``ros2 topic echo``."""
    statuses = [_correction(index, line) for index, line in enumerate(result.lines, 1)]
    return behind_header(header, status_fields(statuses))


def _correction(index: int, line: RunwayLine) -> Status:
    if not line.found:
        message = 'not found'
    elif line.corrected and line.role is LineRole.UNKNOWN:
        message = 'corrected: the old values are kept'
    elif line.corrected:
        message = 'moved by more than the threshold'
    else:
        message = 'ok'
    values = texts(
        rho=line.rho,
        theta_deg=math.degrees(line.theta),
        rho_flag=line.rho_flag,
        theta_flag=line.theta_flag,
        corrected=line.corrected,
    )
    role = '' if line.role is LineRole.UNKNOWN else f' ({line.role.name.lower()})'
    return Status(OK if message == 'ok' else WARN, f'line {index}{role}', message, values)


def encode_statistics(summary: RunwaySummary, header: bytes) -> bytes:
    """A DiagnosticArray, the GUI's result section: totals first, then one status per line."""
    values = texts(
        frames=summary.frames,
        rho_flags=summary.rho_flags,
        theta_flags=summary.theta_flags,
        combined_flags=summary.corrected,
    )
    values['frames_with_flags'] = summary.flag_text
    total = Status(OK, 'runway', f'{summary.frames} frames', values)
    lines = [_line_statistics(index, line) for index, line in enumerate(summary.lines, 1)]
    return behind_header(header, status_fields([total, *lines]))


def _line_statistics(index: int, line: LineSummary) -> Status:
    values = texts(
        found=line.found,
        rho_flags=line.rho_flags,
        theta_flags=line.theta_flags,
        combined_flags=line.corrected,
        rho_mean=line.rho_mean,
        rho_std=line.rho_std,
        theta_mean_deg=math.degrees(line.theta_mean),
        theta_std_deg=math.degrees(line.theta_std),
    )
    return Status(OK, f'line {index}', f'found in {line.found} frames', values)

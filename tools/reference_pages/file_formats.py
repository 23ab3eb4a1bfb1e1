"""The page of file formats; topics and columns come from the code that writes them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message

from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.marker_messages import POINT
from mvuav_ros.messages.poses import encode_integrity
from mvuav_ros.messages.runway_messages import LINE
from mvuav_ros.offline.evaluation.corners import COLUMNS as CORNER_COLUMNS
from mvuav_ros.offline.frame_messages import frame_messages
from mvuav_ros.processing.registry import PROCESSORS
from mvuav_ros.recordings.result_rows import ANGLE_COLUMNS, POSE_COLUMNS
from mvuav_ros.sources.opening import open_source
from mvuav_ros.vision.integrity import ProtectionLevels, RunwayLevels

ROOT = Path(__file__).resolve().parent.parent.parent
TRUTH = {
    '/camera_info': 'calibration',
    '/image_raw': 'images',
    '/imu': 'attitude with a constant error and noise, for mode `approach`',
    '/truth/lines': 'left edge, right edge, centreline, far end, near end, as `~/line_params`',
    '/truth/markers': 'as `~/markers`; state 2 where the light cannot be seen',
    '/truth/pose': 'as `~/pose` (m)',
    '/truth/rpy': 'x: roll between the wings as projected (rad)',
}
ROWS: dict[tuple[str, str], np.dtype[np.void]] = {
    ('marker_tracker', 'markers'): POINT,
    ('runway_detector', 'line_params'): LINE,
}
COLUMNS = {
    'Vector3Stamped': ('x', 'y', 'z'),
    'PointStamped': ('x', 'y', 'z'),
    'PoseWithCovarianceStamped': (
        *POSE_COLUMNS,
        *ANGLE_COLUMNS,
        'cov_x_x',
        'cov_x_y',
        '…',
        'cov_rz_rz',
    ),
}
ADDED = {'markers': ('name', 'state_name'), 'line_params': ('theta_deg', 'role_name')}
_PARAMETERS = """\
## Parameter files

Ordinary ROS 2 parameter files. `--params-file` of nodes and of `mvuav` read them, `ros2 param dump` writes
them. `config/default.yaml` holds every default, `config/thesis.yaml` the values of the thesis.

```yaml
/**/marker_tracker:          # a node's name; wildcards and namespaces as in ROS 2
  ros__parameters:
    threshold: 0.6
```

A value outside of its range is an error, as is an unknown name or a misspelt node. A ROS node only warns of the last two.
Sections of other nodes may stand in the file; one for all nodes (`/**`) may hold parameters of each of them. `mvuav` takes
a node's section whatever its namespace; of several that differ, the one of the namespace that `--image-topic` is in.
"""
_CALIBRATION = """\
## Calibration

For `camera_info_url` of `video_source`, `--camera-info` of `mvuav` and `load_calibration`. `mvuav calibrate` and
camera_calibration save this YAML file:

| key | content |
|---|---|
| `image_width`, `image_height` | px; images of another size are not used with it |
| `distortion_model` | `plumb_bob`, `rational_polynomial` or `equidistant` |
| `camera_matrix` | `data`: 9 numbers, row by row: fx 0 cx, 0 fy cy, 0 0 1 |
| `distortion_coefficients` | `data`: k1, k2, p1, p2, k3 …; `equidistant`: k1 to k4 |
| `rectification_matrix` | `data`: 9 numbers |
| `projection_matrix` | `data`: 12 numbers |

Files of two other tools are read as they are:

* OpenCV's calibration sample (YAML, XML or JSON of `cv2.FileStorage`): the same keys without the last two, and
  `fisheye_model: 1` where the coefficients are those of `cv2.fisheye`. What a program of your own saves needs
  `image_width` and `image_height`, too.
* Kalibr's `camchain.yaml` of one camera, `pinhole-radtan` or `pinhole-equi`. Of a file of several copy the section of yours.
"""
_MANIFEST = """\
## Output folder of a replay

`mvuav replay INPUT... -o FOLDER` writes one bag for each recording and `manifest.json`: `version`, `started`,
`ended`, `settings`, and in `recordings` an entry for each input:

| key | content |
|---|---|
| `input`, and its size and time of change | what was read |
| `output`, `output_bytes` | the bag |
| `outcome` | `begun` until it ends, then `finished`, `finished before`, `failed`, `interrupted` or `refused` (a file was in the way) |
| `frames`, `processed`, `rejected` | counts, once it ended |
| `errors`, `warnings` | what was lost or unusual |
| `failure` | the reason, where it failed |

A bag of results says in its metadata which input, version and parameters made it.
"""
_SWEEP = """\
## Folder of a sweep or an evaluation

| file | content |
|---|---|
| `index.html` | the report: one page, images included |
| `report.json` | settings and all numbers |
| `sweep.csv` | sweep only: a row for each run: parameters, then the numbers |
| `*.csv`, `*.json` | every table |
| `*.png` | every figure |
"""


def file_formats_page() -> str:
    """The page."""
    parts = [
        '# File formats\n',
        '<!-- made by tools/make_reference.py (make docs) from the code -->\n',
        _PARAMETERS,
        _rig(),
        _CALIBRATION,
    ]
    parts += [_bags(), _MANIFEST, _exports(), _SWEEP, _corners()]
    return '\n'.join(parts)


def _rig() -> str:
    text = (ROOT / 'config' / 'tanker_747.yaml').read_text(encoding='utf-8')
    return (
        '## Marker rig\n\nParameter `layout` of `marker_tracker` and of `mvuav simulate tanker`; '
        '`mvuav rig check FILE` examines one,\n`mvuav rig calibrate` writes one, with `standard_deviations` (m, for people).\nThe built-in one is:\n\n```yaml\n'
        + text
        + '```\n'
    )


def _bags() -> str:
    lines = ['## Bags', '', 'A simulated flight (`mvuav simulate`) holds:', '']
    lines += ['| topic | type | content |', '|---|---|---|']
    flight = _flight_topics()
    if flight.keys() != TRUTH.keys():
        raise ValueError(f'{flight.keys() ^ TRUTH.keys()} on one side only')
    lines += [f'| `{name}` | {flight[name]} | {TRUTH[name]} |' for name in sorted(flight)]
    lines += [
        '',
        'A bag of results (`mvuav replay`) is mcap with zstd chunks and embedded schemas. It holds '
        'the topics of\nthe nodes, see [Topics and services](topics.md), and with `--keep-inputs` '
        'those of the input.',
    ]
    return '\n'.join(lines) + '\n'


def _flight_topics() -> dict[str, str]:
    """Topics and types that one frame of each flight has."""
    topics: dict[str, str] = {}
    for kind in ('tanker', 'runway'):
        flight = open_source(f'sim:{kind}?frames=1&width=64&height=64&detail=0')
        messages = frame_messages(next(flight.frames()))
        topics |= {name: type_name for name, type_name, _ in messages}
    return topics


_EXPORTED = """\
## Exported tables

`mvuav export RESULTS... -o FOLDER --format csv|parquet|tum|mot` writes one file for each topic, with the rows of all
flights; a folder of results counts as all of them. `--plot` also draws a page for each flight and an overview.
CSV and Parquet begin with these columns; missing values are `nan`:

| column | meaning |
|---|---|
| `flight` | name of the recording |
| `stamp_ns` | stamp of the image, ns |
| `stamp` | the same in s, to about 0.2 µs |
| `row` | number of the row in its message, from 0 |

Angles are in rad, and in degrees where the name ends in `_deg`. `roll`, `pitch` and `yaw` of `~/pose` of
`marker_tracker` are those against a body that flies straight ahead; of other poses they are those of the quaternion.
`cov_x_y` is the covariance of x and y (m²); `rx`, `ry`, `rz` are small turns about the axes of the pose's frame (rad). In
`~/pose` of `runway_detector` they are its roll, pitch and yaw.
The rows of `markers` end with the marker's `name`, empty where the recording does not show it, and with `state` in words. Units are those of the
[topics](topics.md). The columns of `integrity` are those of [Protection levels](../integrity.md).

| file | columns after these |
|---|---|
"""
_TRAJECTORIES = """\

`tum` holds poses that are known, for evo: `time x y z qx qy qz qw`, in s and m. `mot` holds markers that were measured,
for TrackEval, as MOTChallenge has it: frame from 1, id, left, top, width and height of a box with the marker's area (px),
confidence, and three times -1. The id is the marker's label and 1, in `track_any` the light's number, and in `detect_any`
-1, as of detections. `/truth/markers` has no areas, so its file is empty. In a replay's results
frames that could not be used are counted as well. Of several flights each has its own such file,
`FOLDER/TOPIC/FLIGHT`.
"""


def _exports() -> str:
    lines = []
    for node, processor in PROCESSORS.items():
        for topic, kind in processor.topics.items():
            if topic == 'rpy':
                columns: Sequence[str] = ANGLE_COLUMNS
            elif topic == 'integrity':
                columns = _integrity_columns(node)
            elif kind.__name__ in COLUMNS:
                columns = COLUMNS[kind.__name__]
            elif kind.__name__ == 'PointCloud2':
                columns = (*(ROWS[node, topic].names or ()), *ADDED[topic])
            else:
                continue
            file = f'{node}_{topic.replace("/", "_")}'
            lines.append(f'| `{file}` | {", ".join(columns)} |')
    return _EXPORTED + '\n'.join(lines) + '\n' + _TRAJECTORIES


def _integrity_columns(node: str) -> list[str]:
    levels = ProtectionLevels() if node == 'marker_tracker' else RunwayLevels()
    limits = (0.0,) * (3 if node == 'marker_tracker' else 2)
    message = encode_integrity(levels, limits, 0.0, cdr_header(0, ''))
    (status,) = deserialize_message(message, DiagnosticArray).status
    return ['state', 'reason', *(each.key for each in status.values)]


def _corners() -> str:
    return (
        '## Labelled corners\n\n`mvuav evaluate corners FILE` reads a CSV file with these columns '
        f'(px): {", ".join(CORNER_COLUMNS)}.\nThe images lie beside it. `--horizon` takes another: '
        'file, row_at_centre (px), slope_deg (right end down\npositive).\n'
    )

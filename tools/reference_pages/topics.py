"""The page of topics and services.

Names and directions are those of the SROS2 policies, which a test holds against the graph of the
running nodes; types are the processors'. A topic without a description is an error.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from mvuav_ros.messages.marker_messages import NUMBERED_POINT
from mvuav_ros.messages.runway_messages import LINE
from mvuav_ros.processing.registry import PROCESSORS

ROOT = Path(__file__).resolve().parent.parent.parent
NODES = ('video_source', *PROCESSORS, 'tuning_panel')
OF_EVERY_NODE = {'rosout', 'parameter_events', 'clock', '~/transition_event'}
_STANDARD_SERVICES = ('parameters', 'type', 'state', 'transition')

TYPES = {
    'image_raw': 'sensor_msgs/Image',
    'image_raw/compressed': 'sensor_msgs/CompressedImage',
    'camera_info': 'sensor_msgs/CameraInfo',
    'imu': 'sensor_msgs/Imu',
    'diagnostics': 'diagnostic_msgs/DiagnosticArray',
    'tf': 'tf2_msgs/TFMessage',
    'tf_static': 'tf2_msgs/TFMessage',
    '~/detections': 'vision_msgs/Detection2DArray',
    '~/detections_3d': 'vision_msgs/Detection3DArray',
}
INPUTS = {
    'image_raw': 'Images. The node takes the newest image when it is slower than the camera.',
    'image_raw/compressed': 'The same as JPEG or PNG, with `image_transport: compressed`.',
    'camera_info': 'Calibration. Without one, results are in pixels only.',
    'imu': 'Attitude of the body (REP 145), used in mode `approach`.',
    'tf_static': (
        'Where the camera is mounted (`base_frame`), and whose frames are not to be published.'
    ),
}
_TRANSFORMS = {
    'marker_tracker': 'Camera to body or body to camera (`publish_tf`), while the pose is known.',
    'runway_detector': 'The same, camera and runway, while all six numbers of the pose are known.',
}
OUTPUTS: Mapping[str, Mapping[str, str]] = {
    'video_source': {
        'image_raw': 'Images of the source.',
        'image_raw/compressed': 'The same as JPEG, while somebody subscribes.',
        'camera_info': 'The calibration, beside `image_raw`; all zeros where there is none.',
        'diagnostics': 'Once a second, see [Diagnostics](diagnostics.md).',
    },
    **{
        name: {
            'diagnostics': 'Once a second, see [Diagnostics](diagnostics.md).',
            **({'tf': _TRANSFORMS[name]} if name in _TRANSFORMS else {}),
            **{f'~/{topic}': text for topic, text in processor.descriptions.items()},
        }
        for name, processor in PROCESSORS.items()
    },
    'tuning_panel': {},
}
SERVICES = {
    '~/pause': ('std_srvs/SetBool', 'Pause the source, or go on.'),
    '~/restart': ('std_srvs/Trigger', 'Play the source from its start.'),
    '~/reset': ('std_srvs/Trigger', 'Forget all earlier frames.'),
    '~/enable': ('std_srvs/SetBool', 'Answer images, or only count them.'),
    '~/reset_statistics': ('std_srvs/Trigger', 'Begin `~/statistics` at zero.'),
}
FIELDS = {
    'x': 'px; of a line the first end of its segment',
    'y': 'px',
    'z': '0, NaN where x is NaN',
    'vx': 'px/s',
    'vy': 'px/s',
    'ax': 'px/s²',
    'ay': 'px/s²',
    'area': 'px',
    'label': 'row of the rig: 0 left_wing, 1 left_stabilizer, 2 rudder, 3 right_stabilizer, '
    '4 right_wing; 255 without a name',
    'state': '0 lost, 1 detected, 2 predicted',
    'id': 'only in mode `track_any`: number that a light keeps',
    'x2': 'px, the second end of the segment',
    'y2': 'px',
    'rho': 'px; x cos θ + y sin θ = ρ on the whole frame',
    'theta': 'rad',
    'votes': 'edge points on the line; NaN where there are none to count',
    'rho_raw': 'px, as measured in this frame',
    'theta_raw': 'rad, as measured in this frame',
    'flags': 'bits: 1 rho error, 2 theta error, 4 corrected',
    'role': '0 in mode `thesis`; 1 left edge, 2 right edge, 3 centreline, 4 far end, 5 near end',
    'confidence': '0 to 1; of a marker the probability of its name where `prediction` is `kalman`, of a '
    'line in mode `approach`; NaN otherwise',
}
_HEAD = """\
# Topics and services

<!-- made by tools/make_reference.py (make docs) from the processors and sros2/ -->

`~/` stands for the name of the node, `/marker_tracker/` for example. Pixel (0, 0) is the centre of the
top-left pixel, x to the right, y down. Angles in messages are radians.

Each image gets exactly one message on each per-frame topic, with the header of the image. Missing
values are NaN; the message is always published. The exceptions are `~/marker/*`, `~/vision_pose` and
`/tf`, which are silent while there is nothing to say, and `/runway_detector/pose`, which is silent without what it
needs (see there). `mvuav replay` writes the same topics into a bag, without
`diagnostics`, and with `tf` where tf2_msgs is installed.
"""


def topics_page() -> str:
    """The page."""
    parts = [_HEAD]
    for node in NODES:
        parts.append(f'## {node}\n')
        publish, subscribe, services = _policy(node)
        if node == 'tuning_panel':
            parts.append(
                'Publishes nothing. It subscribes to the results, images and diagnostics of the '
                'nodes that it\nfinds, and sets their parameters; see '
                '[The tuning panel](../panel.md).\n'
            )
            continue
        if subscribe:
            parts.append(_topics('subscribes', {name: INPUTS[name] for name in subscribe}, node))
        outputs = OUTPUTS[node]
        if publish != set(outputs):
            raise ValueError(f'{node} publishes {publish}, described are {set(outputs)}')
        parts.append(_topics('publishes', outputs, node))
        parts.append(_services(services))
    parts.append(_fields('~/markers', NUMBERED_POINT) + '\n' + _fields('~/line_params', LINE))
    return '\n'.join(parts)


def _policy(node: str) -> tuple[set[str], list[str], list[str]]:
    """Topics published, topics subscribed, and services, without those of every node."""
    tree = ET.parse(ROOT / 'sros2' / f'{node}.policy.xml')

    def names(kind: str, attribute: str) -> list[str]:
        found = tree.iterfind(f'.//{kind}[@{attribute}="ALLOW"]/*')
        return [str(each.text) for each in found if each.text not in OF_EVERY_NODE]

    published = {
        '~/marker/*' if name.startswith('~/marker/') else name
        for name in names('topics', 'publish')
    }
    services = [
        name
        for name in names('services', 'reply')
        if not any(word in name for word in _STANDARD_SERVICES)
    ]
    return published, names('topics', 'subscribe'), services


def _topics(verb: str, described: Mapping[str, str], node: str) -> str:
    rows = [f'| {verb} | type | content |', '|---|---|---|']
    rows += [f'| `{name}` | {_type(node, name)} | {text} |' for name, text in described.items()]
    return '\n'.join(rows) + '\n'


def _type(node: str, topic: str) -> str:
    if topic in TYPES:
        return TYPES[topic]
    processor, below = PROCESSORS[node], topic.removeprefix('~/')
    if below in processor.debug_topics:
        return TYPES['image_raw']
    if below == 'marker/*':
        below = next(name for name in processor.topics if name.startswith('marker/'))
    kind = processor.topics.get(below) or processor.periodic_topics[below]
    return f'{kind.__module__.split(".")[0]}/{kind.__name__}'


def _services(names: Iterable[str]) -> str:
    rows = ['| service | type | what it does |', '|---|---|---|']
    rows += [f'| `{name}` | {SERVICES[name][0]} | {SERVICES[name][1]} |' for name in names]
    rows += ['', 'With the services of every managed node: parameters and lifecycle.']
    return '\n'.join(rows) + '\n'


def _fields(topic: str, dtype: np.dtype[np.void]) -> str:
    rows = [f'## Fields of {topic}', '', '| field | type | byte | content |', '|---|---|---|---|']
    assert dtype.fields is not None
    for name, (kind, offset, *_) in dtype.fields.items():
        rows.append(f'| `{name}` | {kind} | {offset} | {FIELDS[name]} |')
    rows += ['', f'A row is {dtype.itemsize} bytes. Read fields by name: new ones go behind.']
    if topic == '~/markers':
        rows[-1] = rows[-1].replace('bytes.', 'bytes; without `id` 38, with `confidence` at 34.')
    return '\n'.join(rows) + '\n'

"""The page of diagnostics; the keys are asked of the code, and each must be described."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from mvuav_ros.nodes.diagnostics import WINDOW, DetectorStatus, FrameStatistics, SourceStatus
from mvuav_ros.nodes.image_input import InputEvents, InputState

REJECTIONS = ('bad image', 'duplicate stamp', 'internal error')

DETECTOR = {
    'state': '`running` or `disabled` (service `~/enable`)',
    'input_rate_hz': f'images received, over the last {WINDOW:.0f} s',
    'output_rate_hz': f'images answered, over the last {WINDOW:.0f} s',
    'latency_p50_ms': 'from the bytes in hand to the last message sent: median',
    'latency_p95_ms': 'the same, 95th percentile',
    'latency_p99_ms': 'the same, 99th percentile',
    'transport_p50_ms': 'from publication to the bytes in hand, as far as the clocks agree',
    'decode_p50_ms': 'from bytes to an image',
    'process_p50_ms': 'from the image to messages',
    'publish_p50_ms': 'from messages to the middleware',
    'frames_received': 'images that arrived, since the start',
    'frames_processed': 'images that were answered',
    'frames_rejected': 'images that could not be used',
    'rejected_bad_image': 'of these: encoding, size or data cannot be read',
    'rejected_duplicate_stamp': 'of these: the stamp of the image before',
    'rejected_internal_error': 'of these: an error in the node itself; please report it',
    'last_rejection': 'the reason of the newest',
    'frames_skipped': 'images passed over because a newer one was there',
    'frames_lost_in_transport': 'images that the middleware reports as lost',
    'frames_missing': 'images that left the publisher and were overwritten or lost',
    'frames_left_out_by_stamps': 'gaps in the stamps: the camera or its driver dropped images',
    'stamp_rate_hz': 'image rate according to the stamps',
    'stamp_jumps_back': 'stamps earlier than the one before (a looping bag); each resets the state',
    'stamp_jumps_forward': f'gaps of more than {WINDOW:.0f} s',
    'image': 'size and encoding of the newest image',
    'image_topic': 'the resolved input topic',
    'calibration': 'what of camera_info is used: none (with the reason), K and d, or P of rectified images',
    'image_publishers': 'nodes that publish it',
    'incompatible_publishers': 'publishers whose QoS does not match',
}
SOURCE = {
    'state': '`waiting` for subscribers, `playing`, `paused`, `ended`, `retrying`, or the lifecycle '
    'state',
    'source': 'what is played',
    'rate_hz': f'images published, over the last {WINDOW:.0f} s',
    'frames_published': 'images published, since the start',
    'image': 'size and encoding of the newest image',
    'subscribers': 'of the images',
    'troubles': 'problems since the start',
    'last_trouble': 'the newest of them',
}
MESSAGES = (
    ('no images: nothing publishes …', 'wrong topic name or remapping', '`image_publishers`'),
    (
        'no images: … with an incompatible QoS (…)',
        'publisher and subscriber do not match; set `qos_overrides`',
        '`incompatible_publishers`',
    ),
    (
        'n images lost in transport: …',
        '[Getting images through](../transport.md)',
        '`frames_lost_in_transport`',
    ),
    (
        'too slow for the camera: n images skipped; …',
        'lower the rate or the image size',
        '`frames_skipped`, `frames_missing`',
    ),
    (
        'gaps in the stamps: n images …',
        'the camera, its driver or the recording dropped them',
        '`frames_left_out_by_stamps`',
    ),
    (
        'n of m images rejected: …',
        'bad images, or stamps that repeat',
        '`rejected_…`, `last_rejection`',
    ),
    (
        'n images have no stamp, …: the time of their sending counts',
        'let the camera driver set stamps; a simulation has to publish `/clock`',
        '',
    ),
    (
        'n nodes are named …: while they run, their results are mixed',
        'give each its own name or namespace; one that died is counted for some seconds more',
        '',
    ),
    (
        'n publishers on …: their images are mixed',
        'two cameras publish one topic',
        '`image_publishers`',
    ),
    (
        'no pose: nothing publishes …/camera_info',
        'said beside `running`: calibrate the camera, remap `camera_info`, or set `pose` to false',
        '',
    ),
    (
        'no attitude: nothing publishes …; there is …',
        'said beside `running` in mode `approach`: remap `imu`',
        '',
    ),
    (
        'parameters without effect: … (did you mean …?)',
        'given at the start, and no parameter of the node, or in a file for another namespace',
        '',
    ),
    (
        'remappings without effect: …',
        'given at the start, and no topic or service of the node, as with the two names reversed',
        '',
    ),
    ('… has no effect: it counts with mode …', 'said beside `running`: another mode is set', ''),
    (
        'no /tf: … is a child of … on /tf_static, …',
        'two would be the parent of one frame; see [Frames](../ros.md#frames-and-units)',
        '',
    ),
    (
        '… looks up by /tf_static, where optical frames have z ahead: …',
        "the images are in the frame of the camera's body: `camera_frame` names its optical one",
        '',
    ),
    (
        'no ~/vision_pose of …: camera_mount_xyz …',
        '`base_frame` is set, and nobody tells where the camera is on it',
        '',
    ),
    (
        'no pose: …',
        'the markers do not fit the rig, or two solutions fit; see '
        '[Troubleshooting](../concepts/troubleshooting.md#no-pose)',
        '',
    ),
)
_HEAD = f"""\
# Diagnostics

<!-- made by tools/make_reference.py (make docs) from mvuav_ros/nodes -->

Each node publishes one status on `/diagnostics` once a second. The message is one line: `running`, or what
is wrong and what helps. The level is OK, WARN (something was wrong in the last {WINDOW:.0f} s), STALE (a detector
never got an image) or ERROR (a source cannot be opened and is tried again).

```text
ros2 topic echo /diagnostics
```

Values are text. Times are milliseconds; `nan` means that there was nothing to measure.
"""


def diagnostics_page() -> str:
    """The page."""
    parts = [_HEAD, '## Messages\n', '| message | meaning or remedy | keys |\n|---|---|---|']
    parts += [f'| `{message}` | {remedy} | {keys} |' for message, remedy, keys in MESSAGES]
    parts.append('\n' + _keys('marker_tracker and runway_detector', detector_keys(), DETECTOR))
    parts.append('\n' + _keys('video_source', source_keys(), SOURCE))
    parts.append(
        '\n## Tuning panel\n\nThe panel publishes no diagnostics; it shows those of the others.\n'
    )
    return '\n'.join(parts)


def detector_keys() -> list[str]:
    """The keys of a detector's status, with every kind of rejection."""
    statistics = FrameStatistics()
    for kind in REJECTIONS:
        statistics.reject(kind, '')
    processor: Any = SimpleNamespace(status='', resets=0, calibration='')
    images = InputState('/image_raw', [], InputEvents())
    status = DetectorStatus(statistics, processor).report('/node', images, [])
    return [each.key for each in status.values]


def source_keys() -> list[str]:
    """The keys of a source's status."""
    status = SourceStatus('').report('/video_source', paused=False, subscribers=0)
    return [each.key for each in status.values]


def _keys(title: str, found: list[str], described: dict[str, str]) -> str:
    if set(found) != set(described):
        raise ValueError(f'{title}: {set(found) ^ set(described)} on one side only')
    rows = [f'## Keys of {title}', '', '| key | meaning |', '|---|---|']
    return '\n'.join([*rows, *(f'| `{key}` | {described[key]} |' for key in found)])

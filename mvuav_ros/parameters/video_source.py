"""The parameters of ``video_source``."""

from __future__ import annotations

from dataclasses import dataclass

from mvuav_ros.parameters.declaration import ParameterSet, parameter
from mvuav_ros.parameters.image_input import AUTOSTART


@dataclass(frozen=True)
class VideoSourceParameters(ParameterSet):
    """Where images come from and how they are published."""

    source: str = parameter(
        '0',
        'A camera index or device, a video file, a folder or glob of images, or a bag (.mcap, '
        'rosbag2 folder, .db3, ROS 1 .bag).',
        read_only=True,
    )
    bag_topic: str = parameter(
        '',
        'The image topic of a bag; may be empty where the bag has only one.',
        read_only=True,
    )
    rate: float = parameter(
        0.0,
        "Frames per second; 0: at the times of the source's own stamps.",
        minimum=0.0,
        maximum=10_000.0,
        unit='Hz',
    )
    loop: bool = parameter(False, 'Play again from the start at the end.')
    encoding: str = parameter(
        'source',
        'Encoding of the published images; source: as they come.',
        choices=('source', 'mono8', 'bgr8', 'rgb8'),
    )
    gamma: float = parameter(
        1.0,
        'out = in ** gamma on the range 0 to 1; 1: off.',
        minimum=0.01,
        maximum=100.0,
        thesis='eq. 3.2',
    )
    frame_id: str = parameter(
        '', "Frame of the published headers; empty: the source's own, or camera_optical_frame."
    )
    camera_info_url: str = parameter(
        '',
        'Calibration file (YAML of camera_calibration), as a path or file:// URL; empty: '
        'uncalibrated.',
        read_only=True,
    )
    stamp: str = parameter(
        'source',
        'source: stamps of the source (bag headers, frame index / frame rate, camera time). '
        'now: the time of publishing.',
        choices=('now', 'source'),
    )
    jpeg_quality: int = parameter(
        90,
        'Of image_raw/compressed, which is made only while somebody subscribes.',
        minimum=1,
        maximum=100,
        unit='%',
    )
    wait_for_subscribers: int = parameter(
        1,
        'A recording starts only when image_raw has this many subscribers, so that none of its '
        'frames is lost; 0: at once. A camera never waits.',
        minimum=0,
        maximum=100,
        read_only=True,
    )
    autostart: bool = parameter(True, AUTOSTART, read_only=True)

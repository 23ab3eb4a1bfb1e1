"""The parameters of ``video_source``."""

from __future__ import annotations

from dataclasses import dataclass

from mvuav_ros.parameters.declaration import ParameterError, ParameterSet, parameter
from mvuav_ros.parameters.image_input import autostart


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
        'Image topic of a bag; may be empty if the bag has only one.',
        read_only=True,
    )
    rate: float = parameter(
        0.0,
        'Frame rate of playback; 0: as given by the stamps of the source.',
        limits=(0.0, 10_000.0),
        unit='Hz',
    )
    loop: bool = parameter(False, 'Play again from the start at the end.')
    width: int = parameter(
        0,
        'Image width requested from a camera; 0: its default.',
        limits=(0, 100_000),
        unit='px',
        read_only=True,
    )
    height: int = parameter(
        0,
        'Image height requested from a camera; 0: its default.',
        limits=(0, 100_000),
        unit='px',
        read_only=True,
    )
    fps: float = parameter(
        0.0,
        'Frame rate requested from a camera; 0: its default.',
        limits=(0.0, 10_000.0),
        unit='Hz',
        read_only=True,
    )
    pixel_format: str = parameter(
        '',
        'Pixel format requested from a camera, as the four letters of V4L2 (YUYV, MJPG, GREY …); '
        'empty: its default. Images are published as bgr8 or mono8.',
        read_only=True,
    )
    exposure_time_absolute: int = parameter(
        0,
        'V4L2 control of this name, if the driver has it; 0: unchanged.',
        limits=(0, 1_000_000),
        unit='100 µs',
        read_only=True,
    )
    gain: int = parameter(
        -1,
        'V4L2 control of this name, if the driver has it; -1: unchanged.',
        limits=(-1, 1_000_000),
        read_only=True,
    )
    encoding: str = parameter(
        'source',
        'Encoding of the published images; source: that of the source.',
        choices=('source', 'mono8', 'bgr8', 'rgb8'),
    )
    gamma: float = parameter(
        1.0,
        'out = in ** gamma on the range 0 to 1; 1: off.',
        limits=(0.01, 100.0),
        thesis='eq. 3.2',
    )
    frame_id: str = parameter(
        '', "Frame of the published headers; empty: the source's own, or camera_optical_frame."
    )
    camera_info_url: str = parameter(
        '',
        'Calibration file (YAML of camera_calibration), as a path, a file:// or a package:// URL; '
        'empty: uncalibrated.',
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
        'JPEG quality of image_raw/compressed, which is made only while somebody subscribes.',
        limits=(1, 100),
        unit='%',
    )
    wait_for_subscribers: int = parameter(
        1,
        'A recording starts only when image_raw has this many subscribers, so that none of its '
        'frames is lost; 0: start at once. A camera never waits.',
        limits=(0, 100),
        read_only=True,
    )
    autostart: bool = autostart()

    def _check_together(self) -> None:
        if len(self.pixel_format) not in (0, 4) or not self.pixel_format.isascii():
            raise ParameterError(
                'pixel_format', f'must be four letters, as in YUYV, not {self.pixel_format!r}'
            )

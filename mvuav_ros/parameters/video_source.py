"""The parameters of ``video_source``."""

from __future__ import annotations

from dataclasses import dataclass

from mvuav_ros.parameters.common_parameters import ManagedParameters, at_start
from mvuav_ros.parameters.declaration import ParameterError, parameter


@dataclass(frozen=True)
class VideoSourceParameters(ManagedParameters):
    """Where images come from and how they are published."""

    source: str = at_start(
        '0',
        'A camera index or device, a video file, a folder or glob of images, a bag (.mcap, rosbag2 '
        'folder, .db3, ROS 1 .bag), or a synthetic flight (sim:tanker, sim:runway).',
    )
    bag_topic: str = at_start('', 'Image topic of a bag; may be empty if the bag has only one.')
    rate: float = parameter(
        0.0,
        'Frame rate of playback; 0: as given by the stamps of the source.',
        (0.0, 10_000.0),
        unit='Hz',
    )
    loop: bool = parameter(False, 'Play again from the start at the end.')
    width: int = at_start(
        0, 'Image width requested from a camera; 0: its default.', (0, 100_000), unit='px'
    )
    height: int = at_start(
        0, 'Image height requested from a camera; 0: its default.', (0, 100_000), unit='px'
    )
    fps: float = at_start(
        0.0, 'Frame rate requested from a camera; 0: its default.', (0.0, 10_000.0), unit='Hz'
    )
    pixel_format: str = at_start(
        '',
        'Pixel format requested from a camera, as the four letters of V4L2 (YUYV, MJPG, GREY …); '
        'empty: its default. Images are published as bgr8 or mono8.',
    )
    exposure_time_absolute: int = at_start(
        0,
        'V4L2 control of this name, if the driver has it; 0: unchanged.',
        (0, 1_000_000),
        unit='100 µs',
    )
    gain: int = at_start(
        -1, 'V4L2 control of this name, if the driver has it; -1: unchanged.', (-1, 1_000_000)
    )
    encoding: str = parameter(
        'source',
        'Encoding of the published images; source: that of the source.',
        choices=('source', 'mono8', 'bgr8', 'rgb8'),
    )
    gamma: float = parameter(
        1.0,
        'out = in ** gamma on the range 0 to 1: above 1 darkens, below 1 brightens; 1: off.',
        (0.01, 100.0),
        thesis='eq. 3.2',
    )
    frame_id: str = parameter(
        '',
        "Frame of the published headers; empty: the source's own, or camera_optical_frame.",
        is_frame=True,
    )
    camera_info_url: str = at_start(
        '',
        'Calibration file (of camera_calibration, OpenCV or Kalibr), as a path, a file:// or a '
        'package:// URL; empty: uncalibrated.',
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
        (1, 100),
        unit='%',
    )
    wait_for_subscribers: int = at_start(
        1,
        'A recording starts only when image_raw has this many subscribers, so that none of its '
        'frames is lost; 0: start at once. A camera never waits.',
        (0, 100),
    )

    def _check_together(self) -> None:
        if len(self.pixel_format) not in (0, 4) or not self.pixel_format.isascii():
            raise ParameterError(
                'pixel_format', f'must be four letters, as in YUYV, not {self.pixel_format!r}'
            )

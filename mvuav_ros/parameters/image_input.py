"""The parameters that several nodes share."""

from __future__ import annotations

from typing import Any

from mvuav_ros.parameters.declaration import parameter


def image_transport() -> Any:
    """How images come to a processing node."""
    return parameter(
        'raw',
        'Transport of the images. raw: the image topic. The others subscribe to '
        '<image topic>/<transport>: compressed to CompressedImage (JPEG, PNG, H.264, H.265), '
        'ffmpeg to FFMPEGPacket, foxglove to CompressedVideo.',
        choices=('raw', 'compressed', 'ffmpeg', 'foxglove'),
        read_only=True,
        stage='Node',
    )


def image_is_rectified() -> Any:
    """Whether a processing node's images are rectified."""
    return parameter(
        False,
        'The images are rectified: P of camera_info holds for them, without distortion. Images '
        'whose topic begins with image_rect are taken so without this.',
        stage='Node',
    )


def opencv_threads() -> Any:
    """How many threads OpenCV has in a processing node."""
    return parameter(
        1,
        "Number of OpenCV's threads in the node; 0: one for each core. More than one rarely helps: "
        'two made a whole frame of 1920x1080 slower.',
        limits=(0, 64),
        stage='Node',
        usual=(0, 16),
    )


def autostart(stage: str = '') -> Any:
    """Whether a node starts by itself."""
    return parameter(
        True,
        'Configure and activate at the start. false: wait for a lifecycle manager, or for '
        '`ros2 lifecycle set`.',
        read_only=True,
        stage=stage,
    )

"""The parameters that several nodes share."""

from __future__ import annotations

from typing import Any

from mvuav_ros.parameters.declaration import parameter


def image_transport() -> Any:
    """How images come to a processing node."""
    return parameter(
        'raw',
        'raw subscribes to the image topic, another to <image topic>/<its name>: compressed for '
        'JPEG, PNG, H.264 and H.265 in CompressedImage, ffmpeg for FFMPEGPacket, foxglove for '
        'CompressedVideo.',
        choices=('raw', 'compressed', 'ffmpeg', 'foxglove'),
        read_only=True,
        stage='Node',
    )


def opencv_threads() -> Any:
    """How many threads OpenCV has in a processing node."""
    return parameter(
        1,
        'Threads that OpenCV may use in the node; 0: its own choice, one for each core. One frame '
        'is rarely worth more than one: two made a whole frame of 1920x1080 slower.',
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

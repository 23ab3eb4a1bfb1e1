"""The parameters that several nodes share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from mvuav_ros.parameters.declaration import (
    ParameterError,
    ParameterSet,
    ParameterSpec,
    parameter,
)

TRANSPORTS = ('compressed', 'ffmpeg', 'foxglove')
"""Of images, beside the raw ones: each is published below the topic of those."""
_node = partial(parameter, stage='Node')


def autostart(stage: str = '') -> Any:
    """Whether a node starts by itself."""
    return parameter(
        True,
        'Configure and activate at the start. false: wait for a lifecycle manager, or for '
        '`ros2 lifecycle set`.',
        read_only=True,
        stage=stage,
    )


@dataclass(frozen=True, kw_only=True)
class DetectorParameters(ParameterSet):
    """What every detector has; a subclass adds its own, which come first."""

    image_transport: str = _node(
        'raw',
        'Transport of the images. raw: the image topic. The others subscribe to '
        '<image topic>/<transport>: compressed to CompressedImage (JPEG, PNG, H.264, H.265), '
        'ffmpeg to FFMPEGPacket, foxglove to CompressedVideo.',
        choices=('raw', *TRANSPORTS),
        read_only=True,
    )
    image_is_rectified: bool = _node(
        False,
        'The images are rectified: P of camera_info holds for them, without distortion. Images '
        'whose topic begins with image_rect are taken so without this.',
    )
    opencv_threads: int = _node(
        1,
        "Number of OpenCV's threads in the node; 0: one for each core. More than one rarely helps: "
        'two made a whole frame of 1920x1080 slower.',
        limits=(0, 64),
        usual=(0, 16),
    )
    autostart: bool = autostart('Node')

    @classmethod
    def specs(cls) -> tuple[ParameterSpec, ...]:
        """See `ParameterSet.specs`."""
        return tuple(sorted(super().specs(), key=lambda spec: spec.stage == 'Node'))


def publish_tf(make: Callable[..., Any], target: str) -> Any:
    """Whether and which way a pose goes out on /tf; ``make`` declares, ``target`` is its name."""
    return make(
        'camera_to_body',
        f'The pose on /tf, where all of it is known; needs tf2_msgs. camera_to_body: {target} as '
        'child of the camera, for a camera that hangs in a tree of its own. body_to_camera: '
        f'base_frame, or without one the camera, as child of {target}. off: nothing.',
        choices=('camera_to_body', 'body_to_camera', 'off'),
        booleans=('off', 'camera_to_body'),
        read_only=True,
    )


def camera_frame(make: Callable[..., Any]) -> Any:
    """The camera's name on /tf."""
    return make(
        '',
        "Name of the camera's optical frame on /tf; empty: the image's own frame_id.",
        read_only=True,
    )


def base_frame(make: Callable[..., Any]) -> Any:
    """Whose pose ``~/vision_pose`` is."""
    return make(
        '',
        "Frame of the vehicle, such as base_link: ~/vision_pose is then the vehicle's pose, by the "
        "camera's mount: camera_mount_xyz and camera_mount_rpy_deg, or if both are 0 /tf_static; "
        "nothing until that is known. Empty: it is the pose of the camera's body axes.",
        read_only=True,
    )


def camera_mount_xyz(make: Callable[..., Any]) -> Any:
    """Where the camera is on the vehicle."""
    return make(
        (0.0, 0.0, 0.0),
        'Position of the camera on the vehicle (REP 103: x forward, y left, z up), for base_frame.',
        limits=(-1_000.0, 1_000.0),
        unit='m',
    )


def camera_mount_rpy_deg(make: Callable[..., Any], uses: str) -> Any:
    """How the camera is turned on the vehicle."""
    return make(
        (0.0, 0.0, 0.0),
        'Roll, pitch and yaw of the camera on the vehicle (REP 103, fixed axes; all 0: it looks '
        f"along the vehicle's x; pitch 20: 20 degrees down), for {uses}.",
        limits=(-180.0, 180.0),
        unit='°',
    )


def check_frames(parameters: ParameterSet, *names: str) -> None:
    """Raise a `ParameterError` where a frame begins with a slash, which tf2 does not take."""
    for name in names:
        if str(getattr(parameters, name)).startswith('/'):
            raise ParameterError(name, 'must not begin with a slash: tf2 takes no such frame')

"""The parameters that several nodes share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, ClassVar

from mvuav_ros.parameters.declaration import ParameterSet, ParameterSpec, parameter

TRANSPORTS = ('compressed', 'ffmpeg', 'foxglove')
"""Of images, beside the raw ones: each is published below the topic of those."""
_node = partial(parameter, stage='Node')


@dataclass(frozen=True, kw_only=True)
class ManagedParameters(ParameterSet):
    """What every node has."""

    autostart: bool = _node(
        True,
        'Configure and activate at the start. false: wait for a lifecycle manager, or for '
        '`ros2 lifecycle set`.',
        read_only=True,
    )


@dataclass(frozen=True, kw_only=True)
class DetectorParameters(ManagedParameters):
    """What every detector has."""

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


at_start = partial(parameter, read_only=True)
"""Declare what can be set at the start only."""


@dataclass(frozen=True, kw_only=True)
class PosedParameters(ParameterSet):
    """What a detector with a pose has as well: the frames that the pose is between.

    They are alike but for ``declared``: what else a detector says of all of them.
    """

    declared: ClassVar[Mapping[str, Any]]

    publish_tf: str = at_start(
        'camera_to_body',
        'The pose on /tf, where all of it is known; needs tf2_msgs. camera_to_body: body_frame or '
        'runway_frame as child of the camera, for a camera that hangs in a tree of its own. '
        'body_to_camera: base_frame, or without one the camera, as child of that frame. off: '
        'nothing.',
        choices=('camera_to_body', 'body_to_camera', 'off'),
        booleans=('off', 'camera_to_body'),
    )
    camera_frame: str = at_start(
        '',
        "Name of the camera's optical frame on /tf; empty: the image's own frame_id.",
        is_frame=True,
    )
    base_frame: str = at_start(
        '',
        "Frame of the vehicle, such as base_link: ~/vision_pose is then the vehicle's pose, by the "
        "camera's mount: camera_mount_xyz and camera_mount_rpy_deg, or if both are 0 /tf_static; "
        "nothing until that is known. Empty: it is the pose of the camera's body axes.",
        is_frame=True,
    )
    camera_mount_xyz: tuple[float, float, float] = parameter(
        (0.0, 0.0, 0.0),
        'Position of the camera on the vehicle (REP 103: x forward, y left, z up), for base_frame.',
        limits=(-1_000.0, 1_000.0),
        unit='m',
    )
    camera_mount_rpy_deg: tuple[float, float, float] = parameter(
        (0.0, 0.0, 0.0),
        'Roll, pitch and yaw of the camera on the vehicle (REP 103, fixed axes; all 0: it looks '
        "along the vehicle's x; pitch 20: 20 degrees down; roll 180: upside down), for "
        'base_frame, for which way up the body is at the start, and in runway_detector for the '
        'horizon.',
        limits=(-180.0, 180.0),
        unit='°',
    )

    @classmethod
    def specs(cls) -> tuple[ParameterSpec, ...]:
        """See `ParameterSet.specs`."""
        ours = {field.name for field in fields(PosedParameters)}
        declared = partial(replace, **cls.declared)
        return tuple(declared(s) if s.name in ours else s for s in super().specs())

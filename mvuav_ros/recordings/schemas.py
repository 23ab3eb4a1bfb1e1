"""Message types as ROS 2 Jazzy defines them."""

from __future__ import annotations

from functools import cache

from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mvuav_ros.recordings.recording import Schema

_VISION_MSGS = {
    'Point2D': 'float64 x\nfloat64 y',
    'Pose2D': 'Point2D position\nfloat64 theta',
    'BoundingBox2D': 'Pose2D center\nfloat64 size_x\nfloat64 size_y',
    'BoundingBox3D': 'geometry_msgs/Pose center\ngeometry_msgs/Vector3 size',
    'ObjectHypothesis': 'string class_id\nfloat64 score',
    'ObjectHypothesisWithPose': (
        'ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose'
    ),
    **{
        f'Detection{n}': (
            'std_msgs/Header header\nObjectHypothesisWithPose[] results\n'
            f'BoundingBox{n} bbox\nstring id'
        )
        for n in ('2D', '3D')
    },
    **{
        f'Detection{n}Array': f'std_msgs/Header header\nDetection{n}[] detections'
        for n in ('2D', '3D')
    },
}
"""Fields of the messages of ~/detections, which rosbags does not know."""


@cache
def typestore() -> Typestore:
    """Jazzy's own types and `_VISION_MSGS`; made once, as that takes some time."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in _VISION_MSGS.items():
        store.register(get_types_from_msg(text, f'vision_msgs/msg/{name}'))
    return store


@cache
def schema_of(type_name: str) -> Schema | None:
    """The definition of a type 'pkg/msg/Type', None if it is not Jazzy's."""
    try:
        text, _ = typestore().generate_msgdef(type_name, ros_version=2)
    except TypesysError:
        return None
    return Schema('ros2msg', text)


@cache
def type_hash(type_name: str) -> str:
    """The hash of a type's definition as ROS 2 makes it, '' if the type is not Jazzy's."""
    try:
        return typestore().hash_rihs01(type_name)
    except KeyError:
        return ''

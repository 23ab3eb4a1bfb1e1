"""Stamps and frame names as message headers."""

from __future__ import annotations

from typing import Any

from builtin_interfaces.msg import Time
from std_msgs.msg import Header


def stamp_ns_of(header: Any) -> int:
    """A header's stamp in nanoseconds; takes ROS and rosbags messages."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def make_header(stamp_ns: int, frame_id: str) -> Header:
    """The header of a message from its stamp (ns) and frame."""
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    return Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=frame_id)

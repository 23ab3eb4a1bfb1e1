"""Stamps and frame names as message headers."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from std_msgs.msg import Header


def make_header(stamp_ns: int, frame_id: str) -> Header:
    """The header of a message from its stamp (ns) and frame."""
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    return Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=frame_id)

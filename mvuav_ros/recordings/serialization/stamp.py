"""Stamps of message headers, whatever library made the message."""

from __future__ import annotations

from typing import Any


def stamp_ns_of(header: Any) -> int:
    """A header's stamp in nanoseconds; takes ROS and rosbags messages."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)

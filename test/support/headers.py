"""Headers as rclpy has them."""

from builtin_interfaces.msg import Time
from std_msgs.msg import Header

from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.sensors import stamp_ns_of


def make_header(stamp_ns: int, frame_id: str) -> Header:
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    return Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=frame_id)


def header_bytes(header: Header) -> bytes:
    """In CDR."""
    return cdr_header(stamp_ns_of(header), header.frame_id)

"""The floor of ``mvuav bench live``: the least that any rclpy node does with an image."""

from __future__ import annotations

import json
import sys
import time
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CompressedImage, Image


def main() -> None:
    """Take images; when interrupted, print when each came (ns) by its stamp as JSON."""
    compressed = sys.argv[1] == 'compressed'
    arrivals: dict[int, int] = {}

    def take(message: Image | CompressedImage) -> None:
        now = time.time_ns()
        stamp = message.header.stamp
        arrivals[stamp.sec * 1_000_000_000 + stamp.nanosec] = now

    rclpy.init()
    node = rclpy.create_node('bench_floor')
    kind, topic = (CompressedImage, 'image_raw/compressed') if compressed else (Image, 'image_raw')
    node.create_subscription(kind, topic, take, qos_profile_sensor_data)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)
    print(json.dumps(arrivals))


if __name__ == '__main__':
    main()

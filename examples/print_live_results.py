"""Print what a live marker_tracker measures: python examples/print_live_results.py [COUNT]."""

import math
import sys

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped, Vector3Stamped

from mvuav_ros.nodes.running import until_stopped

printed = []


def show_roll(message: Vector3Stamped) -> None:
    """Right wing down is positive."""
    printed.append(print(f'roll {math.degrees(message.vector.x):.1f} deg', flush=True))


def show_pose(message: PoseWithCovarianceStamped) -> None:
    """The tanker, from the camera."""
    place = message.pose.pose.position
    printed.append(print(f'distance {math.hypot(place.x, place.y, place.z):.1f} m', flush=True))


with until_stopped('print_live_results') as node:
    node.create_subscription(Vector3Stamped, '/marker_tracker/rpy', show_roll, 10)
    node.create_subscription(PoseWithCovarianceStamped, '/marker_tracker/pose', show_pose, 10)
    while len(printed) < (int(sys.argv[1]) if len(sys.argv) > 1 else 10):
        rclpy.spin_once(node)

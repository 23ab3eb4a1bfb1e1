"""Print what a live marker_tracker measures: python examples/print_live_roll.py [COUNT]."""

import math
import sys

import rclpy
from geometry_msgs.msg import Vector3Stamped
from rclpy.qos import qos_profile_sensor_data

count = int(sys.argv[1]) if len(sys.argv) > 1 else 10


def show(message: Vector3Stamped) -> None:
    stamp = message.header.stamp
    time = stamp.sec + stamp.nanosec * 1e-9
    print(f'{time:.2f} s: roll {math.degrees(message.vector.x):.1f} deg', flush=True)


rclpy.init()
node = rclpy.create_node('print_live_roll')
node.create_subscription(Vector3Stamped, '/marker_tracker/rpy', show, qos_profile_sensor_data)
for _ in range(count):
    rclpy.spin_once(node)

"""The vehicle's pose to MAVROS in east, north, up: pose_for_mavros.py HEADING_DEG (docs/ros.md)."""

import sys

import numpy as np
import rclpy
from geometry_msgs.msg import Point, Quaternion
from geometry_msgs.msg import PoseWithCovarianceStamped as Pose
from rclpy.qos import qos_profile_sensor_data as sensor_data

from mvuav_ros.nodes.running import until_stopped
from mvuav_ros.vision.frames import east_north_up, from_quaternion, quaternion

usage = 'usage: python examples/pose_for_mavros.py HEADING_DEG'
heading_deg = float(sys.argv[1]) if sys.argv[1:] else sys.exit(usage)


def send(message: Pose) -> None:
    """From the runway's axes."""
    pose, p, q = message.pose.pose, message.pose.pose.position, message.pose.pose.orientation
    given = [p.x, p.y, p.z], from_quaternion(q.x, q.y, q.z, q.w)
    covariance = np.reshape(message.pose.covariance, (6, 6))
    position, rotation, covariance = east_north_up(*given, covariance, heading_deg)
    pose.position = Point(**dict(zip('xyz', position.tolist(), strict=True)))
    pose.orientation = Quaternion(**dict(zip('xyzw', quaternion(rotation), strict=True)))
    message.pose.covariance = covariance.ravel().tolist()
    out.publish(message)


with until_stopped('pose_for_mavros') as node:
    out = node.create_publisher(Pose, '/mavros/vision_pose/pose_cov', 10)
    node.create_subscription(Pose, '/runway_detector/vision_pose', send, sensor_data)
    rclpy.spin(node)

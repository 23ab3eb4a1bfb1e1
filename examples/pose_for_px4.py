"""The vehicle's pose to PX4 in north, east, down: pose_for_px4.py HEADING_DEG (docs/ros.md)."""

import sys

import numpy as np
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped as Pose
from px4_msgs.msg import VehicleOdometry
from rclpy.qos import qos_profile_sensor_data as sensor_data

from mvuav_ros.nodes.running import until_stopped
from mvuav_ros.vision.frames import east_north_up, from_quaternion, north_east_down, quaternion

heading_deg = float(sys.argv[1]) if sys.argv[1:] else sys.exit('usage: pose_for_px4.py HEADING_DEG')


def send(message: Pose) -> None:
    """From the runway's axes; what is not known is NaN."""
    p, q, cov = message.pose.pose.position, message.pose.pose.orientation, message.pose.covariance
    given = [p.x, p.y, p.z], from_quaternion(q.x, q.y, q.z, q.w), np.reshape(cov, (6, 6))
    position, rotation, *variances = north_east_down(*east_north_up(*given, heading_deg))
    us = message.header.stamp.sec * 1_000_000 + message.header.stamp.nanosec // 1000
    said = VehicleOdometry(timestamp=us, timestamp_sample=us, pose_frame=1)
    said.position, said.q = np.float32(position), np.float32(np.roll(quaternion(rotation), 1))
    said.position_variance, said.orientation_variance = map(np.float32, variances)
    said.velocity = said.angular_velocity = said.velocity_variance = np.float32([np.nan] * 3)
    out.publish(said)


with until_stopped('pose_for_px4') as node:
    out = node.create_publisher(VehicleOdometry, '/fmu/in/vehicle_visual_odometry', sensor_data)
    node.create_subscription(Pose, '/runway_detector/vision_pose', send, sensor_data)
    rclpy.spin(node)

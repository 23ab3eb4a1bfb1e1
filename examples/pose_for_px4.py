"""The vehicle's pose to PX4 in north, east, down: pose_for_px4.py HEADING_DEG (docs/ros.md)."""

import sys

import numpy as np
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from px4_msgs.msg import VehicleOdometry
from rclpy.qos import qos_profile_sensor_data as sensor_data

from mvuav_ros.vision.frames import east_north_up, from_quaternion, north_east_down, quaternion


def send(message: PoseWithCovarianceStamped) -> None:
    """From the runway's axes; what is not known is NaN."""
    p, q = message.pose.pose.position, message.pose.pose.orientation
    given = [p.x, p.y, p.z], from_quaternion(q.x, q.y, q.z, q.w)
    enu = east_north_up(*given, np.reshape(message.pose.covariance, (6, 6)), float(sys.argv[1]))
    position, rotation, *variances = north_east_down(*enu)
    us = message.header.stamp.sec * 1_000_000 + message.header.stamp.nanosec // 1000
    said = VehicleOdometry(timestamp=us, timestamp_sample=us, pose_frame=1)
    said.position, said.q = np.float32(position), np.float32(np.roll(quaternion(rotation), 1))
    said.position_variance, said.orientation_variance = map(np.float32, variances)
    said.velocity = said.angular_velocity = said.velocity_variance = np.float32([np.nan] * 3)
    out.publish(said)


rclpy.init()
node = rclpy.create_node('pose_for_px4')
out = node.create_publisher(VehicleOdometry, '/fmu/in/vehicle_visual_odometry', sensor_data)
topic = '/runway_detector/vision_pose'
node.create_subscription(PoseWithCovarianceStamped, topic, send, sensor_data)
rclpy.spin(node)

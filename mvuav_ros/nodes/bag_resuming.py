"""``resume_bag``: lets a paused `ros2 bag play` go once the detectors have found it."""

from __future__ import annotations

import sys
from argparse import ArgumentParser
from importlib import import_module

import rclpy
from diagnostic_msgs.msg import DiagnosticArray

from mvuav_ros.nodes.executables import own_arguments

PLAYER = 'rosbag2_player'
SETTLING_TIME = 1.0
"""Seconds from the moment that detectors see the player until it surely sees them."""


def resume_bag() -> None:
    """Wait until as many detectors as asked for name the player as a publisher, then resume it."""
    parser = ArgumentParser('resume_bag')
    parser.add_argument('detectors', type=int, help='how many there are')
    wanted = parser.parse_args(own_arguments()).detectors
    try:
        kind = import_module('rosbag2_interfaces.srv').Resume
    except ImportError as error:
        sys.exit(f'resume_bag needs rosbag2: apt install ros-jazzy-rosbag2 ({error})')
    rclpy.init()
    node, ready = rclpy.create_node('resume_bag'), set[str]()

    def follow(message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if f'/{PLAYER}' in values.get('image_publishers', '').split():
                ready.add(status.name)

    try:
        node.create_subscription(DiagnosticArray, '/diagnostics', follow, 10)
        client = node.create_client(kind, f'/{PLAYER}/resume')
        while len(ready) < wanted or not client.service_is_ready():
            rclpy.spin_once(node, timeout_sec=0.1)
        node.get_clock().sleep_for(rclpy.duration.Duration(seconds=SETTLING_TIME))
        rclpy.spin_until_future_complete(node, client.call_async(kind.Request()))
        node.get_logger().info(f'{", ".join(sorted(ready))} found the bag: it plays')
    except (KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()

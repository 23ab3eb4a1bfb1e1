"""All of it by arguments: ros2 launch mvuav_ros vision.launch.py --show-args."""

from mvuav_ros.nodes.launching import launch_vision


def generate_launch_description():
    return launch_vision(__file__)

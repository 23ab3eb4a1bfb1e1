"""A source of images and both detectors: ros2 launch mvuav_ros both.launch.py source:=0."""

from mvuav_ros.nodes.launching import launch_vision


def generate_launch_description():
    return launch_vision(__file__, detectors='markers,runway')

"""A source of images and runway_detector: ros2 launch mvuav_ros runway.launch.py source:=0."""

from mvuav_ros.nodes.launching import launch_vision


def generate_launch_description():
    return launch_vision(__file__, detectors='runway')

"""A source of images and marker_tracker: ros2 launch mvuav_ros markers.launch.py source:=0."""

from mvuav_ros.nodes.launching import launch_vision


def generate_launch_description():
    return launch_vision(__file__, detectors='markers')

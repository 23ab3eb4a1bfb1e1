"""A source of images and both detectors: ros2 launch mvuav_ros both.launch.py source:=0."""

from mvuav_ros.nodes.launching import launch_flight


def generate_launch_description():
    return launch_flight(__file__, 'video_source', 'marker_tracker', 'runway_detector')

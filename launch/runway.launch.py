"""A source of images and runway_detector: ros2 launch mvuav_ros runway.launch.py source:=0."""

from mvuav_ros.nodes.launching import launch_flight


def generate_launch_description():
    return launch_flight(__file__, 'video_source', 'runway_detector')

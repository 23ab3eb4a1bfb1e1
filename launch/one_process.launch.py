"""All in one process: ros2 launch mvuav_ros one_process.launch.py source:=0 (docs/transport.md)."""

from mvuav_ros.nodes.launching import launch_vision


def generate_launch_description():
    return launch_vision(__file__, one_process='true')

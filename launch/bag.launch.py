"""`ros2 bag play` that loses no image: ros2 launch mvuav_ros bag.launch.py bag:=flight.mcap.

The player starts paused, the detectors ask for reliable delivery, and once they have found the
player it is resumed. Its other arguments are those of vision.launch.py.
"""

from mvuav_ros.nodes.launching import launch_bag


def generate_launch_description():
    return launch_bag(__file__)

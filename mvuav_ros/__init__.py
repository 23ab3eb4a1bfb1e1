"""Machine vision for UAVs on ROS 2: a tanker's marker lights, a runway's lines.

The layers, innermost first; imports only ever point inward:

``parameters``  what the user can set: one frozen dataclass per node (standard library only)
``vision``      NumPy and OpenCV in, plain dataclasses out (no ROS)
``recording``   bags in and out (rosbags, mcap; no ROS)
``sources``     cameras, videos, image folders and bags as one stream of frames (no ROS)
``messages``    vision results to ROS messages (message classes, no rclpy)
``processing``  one frame in, the messages of one node out; live nodes and replay share it
``nodes``       the rclpy nodes
``panel``       the tuning panel's node and page
``cli``         the ``mvuav`` command
"""

__version__ = '0.1.0'

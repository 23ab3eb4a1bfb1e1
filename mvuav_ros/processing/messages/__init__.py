"""Results as ROS messages."""

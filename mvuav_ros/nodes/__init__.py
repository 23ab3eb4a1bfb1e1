"""The rclpy nodes: thin shells around `mvuav_ros.processing` and `mvuav_ros.sources`."""

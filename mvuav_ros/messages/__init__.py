"""ROS messages to pictures and results to ROS messages; message classes only, no rclpy."""

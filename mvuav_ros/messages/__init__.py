"""ROS messages as bytes: CDR, definitions, and images as live nodes and replay decode them."""

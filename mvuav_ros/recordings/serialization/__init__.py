"""ROS messages as bytes: images, headers, calibration, CDR."""

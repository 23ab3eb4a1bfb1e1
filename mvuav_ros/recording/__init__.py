"""Recordings (bags) in and out; knows nothing of a running ROS graph."""

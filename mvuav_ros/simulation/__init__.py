"""Synthetic flights with exact truth; knows nothing of ROS."""

"""The vision library: NumPy arrays in, plain dataclasses out; knows nothing of ROS."""

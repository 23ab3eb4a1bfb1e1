"""Cameras, videos, image folders, bags and simulated flights as one stream of frames."""

"""Cameras, videos, folders, bags and synthetic flights as one stream of frames."""

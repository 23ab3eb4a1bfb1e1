"""Cameras, video files, image folders and bags as one stream of frames."""

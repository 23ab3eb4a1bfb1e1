"""Recordings in and out, however damaged; every source as one stream of frames; image codecs."""

"""Video files through OpenCV."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import cv2

from mvuav_ros.recordings.sources.frame import OPTICAL_FRAME, BadFrame, Frame, SourceError
from mvuav_ros.vision.image import Image

DEFAULT_RATE = 30.0


class VideoFile:
    """A video file; frame k carries the stamp k / frame rate."""

    live = False

    def __init__(self, path: Path, rate: float | None = None) -> None:
        """Open the file.

        Args:
            path: anything that OpenCV's FFmpeg reads.
            rate: frames per second, instead of the file's own.

        Raises:
            SourceError: it is not a video.
        """
        self.name = f'video {path.name}'
        self.losses: list[str] = []
        self._path = path
        capture = self._open()
        own_rate = capture.get(cv2.CAP_PROP_FPS)
        if not (math.isfinite(own_rate) and 0 < own_rate <= 10_000):
            own_rate = DEFAULT_RATE
        self.rate: float | None = rate or own_rate
        frames = capture.get(cv2.CAP_PROP_FRAME_COUNT)
        self.count: int | None = int(frames) if frames > 0 else None
        capture.release()

    def _open(self) -> cv2.VideoCapture:
        capture = cv2.VideoCapture(str(self._path))
        if not capture.isOpened():
            raise SourceError(
                f'{self._path} is not a video that OpenCV can read; convert it, for example with '
                'ffmpeg -i FILE flight.mp4'
            )
        return capture

    def frames(self) -> Iterator[Frame | BadFrame]:
        """Read from the start."""
        assert self.rate is not None
        capture = self._open()
        index = 0
        try:
            while True:
                ok, pixels = capture.read()
                if not ok:
                    break
                yield Frame(round(index * 1e9 / self.rate), OPTICAL_FRAME, _image(pixels))
                index += 1
        finally:
            capture.release()
        # Containers often promise a frame or two more than they hold.
        if self.count is not None and index < self.count - 2:
            self.losses.append(f'the video ended after {index} of {self.count} frames')

    def close(self) -> None:
        """Nothing to let go of: `frames` closes what it opens."""


def _image(pixels: cv2.typing.MatLike) -> Image:
    return Image(pixels, 'mono8' if pixels.ndim == 2 else 'bgr8')

"""Cameras through OpenCV, which speaks V4L2 to them on Linux."""

from __future__ import annotations

import time
from collections.abc import Iterator

import cv2

from mvuav_ros.messages.images import OPTICAL_FRAME, BadFrame, Frame
from mvuav_ros.parameters.video_source import VideoSourceParameters
from mvuav_ros.recordings.account import Account
from mvuav_ros.sources.source import FrameSource, SourceError
from mvuav_ros.vision.image import Image

_MANUAL = 1  # Of V4L2's auto_exposure: manual mode
_FPS_TOLERANCE = 0.05  # Of the frame rate; 29.97 is taken for 30
_CONTROLS = {
    'width': cv2.CAP_PROP_FRAME_WIDTH,
    'height': cv2.CAP_PROP_FRAME_HEIGHT,
    'fps': cv2.CAP_PROP_FPS,
    'exposure_time_absolute': cv2.CAP_PROP_EXPOSURE,
    'gain': cv2.CAP_PROP_GAIN,
}
"""Parameters, which are asked for where they are above their defaults."""


class Camera(FrameSource):
    """A camera by index or device; frames carry the time at which they arrived."""

    live = True
    count: int | None = None

    def __init__(self, device: int | str, settings: VideoSourceParameters | None = None) -> None:
        """Name the camera, and what it is asked for; it is opened when frames are read."""
        self.name = f'camera {device}'
        self.account = Account(self.name)
        self._device = device
        self._settings = settings or VideoSourceParameters()
        self.rate: float | None = self._settings.fps or None
        self._capture: cv2.VideoCapture | None = None

    def frames(self) -> Iterator[Frame | BadFrame]:
        """Read until the camera stops delivering.

        Raises:
            SourceError: it cannot be opened, does not do as asked, or has been unplugged.
        """
        capture = self._capture = cv2.VideoCapture(self._device)
        try:
            if not capture.isOpened():
                raise SourceError(f'{self.name} cannot be opened: is it plugged in and not in use?')
            self._apply(capture)
            while True:
                ok, pixels = capture.read()
                if not ok:
                    raise SourceError(f'{self.name} has stopped delivering frames')
                encoding = 'mono8' if pixels.ndim == 2 else 'bgr8'
                yield Frame(time.time_ns(), OPTICAL_FRAME, Image(pixels, encoding))
        finally:
            self.close()

    def close(self) -> None:
        """Let go of the device."""
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    def _apply(self, capture: cv2.VideoCapture) -> None:
        """Ask for the settings, then compare them with what the camera says."""
        wanted = self._settings
        asked = [
            (name, number, value)
            for name, number in _CONTROLS.items()
            if (value := getattr(wanted, name)) > getattr(VideoSourceParameters, name)
        ]
        if wanted.pixel_format:
            # First, as the sizes and rates that there are depend on it.
            capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*wanted.pixel_format))
        for name, number, value in asked:
            if name == 'exposure_time_absolute':
                capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL)
            capture.set(number, value)
        differences = []
        code = int(capture.get(cv2.CAP_PROP_FOURCC)) & 0xFFFFFFFF
        got = code.to_bytes(4, 'little').decode('latin-1').strip('\0')
        if wanted.pixel_format and got != wanted.pixel_format:
            differences.append(f'pixel_format is {got}, not {wanted.pixel_format}')
        for name, number, value in asked:
            said = capture.get(number)
            if abs(said - value) > (_FPS_TOLERANCE * value if name == 'fps' else 0.5):
                differences.append(f'{name} is {said:g}, not {value:g}')
        if differences:
            raise SourceError(
                f'{self.name}: {", ".join(differences)}; v4l2-ctl --list-formats-ext and '
                '--list-ctrls show what it offers'
            )

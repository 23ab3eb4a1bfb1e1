"""Videos like those of the thesis, written as uncompressed AVI files and read back."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from pathlib import Path

import cv2

from mvuav_ros.messages.frame import Frame
from mvuav_ros.parameters.declaration import Value
from mvuav_ros.simulation.runway_flight import RunwayFlight
from mvuav_ros.simulation.settings import TRIALS
from mvuav_ros.simulation.tanker_flight import TankerFlight
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.point_operations import Pixels
from mvuav_thesis.plan import Plan

_UNCOMPRESSED = 'RGBA'
LOW_PASS: Mapping[str, Value] = {
    'motion': 'low_pass',
    'start_distance': -20.0,
    'speed': 25.0,
    'camera_pitch_deg': 20.0,
}


def trial_images(plan: Plan, number: int) -> list[tuple[Image, int]]:
    """The frames of a trial (1 to 4) and their stamps."""
    flight = TankerFlight(plan.trial(TRIALS[number - 1]))
    return [(frame.image, frame.stamp_ns) for frame in flight]


def runway_images(plan: Plan) -> list[Pixels]:
    """The frames of a low pass over the runway, blue first."""
    return [frame.image.bgr() for frame in RunwayFlight(plan.runway(LOW_PASS))]


def write_avi(path: Path, images: Iterable[Pixels], fps: float) -> None:
    """Write colour frames without compression, as the thesis's file of 150 MB."""
    writer: cv2.VideoWriter | None = None
    for image in images:
        if writer is None:
            size = (image.shape[1], image.shape[0])
            writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*_UNCOMPRESSED), fps, size)
        writer.write(image)
    if writer is not None:
        writer.release()


def read_avi(path: Path, fps: float) -> tuple[list[Frame], list[float]]:
    """Every frame of a video, and the time that reading each took, s.

    With OpenCV, which wrote it: so that the report needs no other library for videos.
    """
    frames: list[Frame] = []
    taken: list[float] = []
    capture = cv2.VideoCapture(str(path))
    while True:
        start = time.perf_counter()
        ok, pixels = capture.read()
        if not ok:
            capture.release()
            return frames, taken
        taken.append(time.perf_counter() - start)
        stamp_ns = round(len(frames) * 1e9 / fps)
        frames.append(Frame(stamp_ns, 'camera', Image(pixels, 'bgr8')))

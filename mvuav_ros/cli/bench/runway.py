"""The runway scheme beside the same sequence in bare OpenCV and in scikit-image."""

from __future__ import annotations

import importlib
import importlib.util
import itertools
import math
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.cli.bench.case import Action, Case
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.vision.runway.detector import RunwayDetector
from mvuav_ros.vision.runway.edges import automatic_threshold

Frame = NDArray[np.uint8]
Baseline = Callable[[Frame, float], object]
"""Of a frame and the threshold of its edges."""

_FRAMES = 8
_VERTICAL = np.ones((3, 1), np.uint8)
_KERNEL_SUM_AND_SCALE = 8 * 255


def runway_cases() -> list[Case]:
    """The cases of the runway scheme; those with scikit-image only where it is installed.

    Both sides take the same synthetic frames in turn, with the default resolutions and peaks. The
    baselines get the threshold and the confined channel for nothing, and they correct no lines.
    """
    slice_frames = [_runway(320, 240, seed) for seed in range(_FRAMES)]
    slices = [np.ascontiguousarray(frame[50:130, :, 2]) for frame in slice_frames]
    whole_frames = [_runway(1280, 720, seed) for seed in range(_FRAMES)]
    wholes = [np.ascontiguousarray(frame[:, :, 2]) for frame in whole_frames]
    whole = RunwayDetectorParameters(start_row=0, end_row=0)

    def in_rows(name: str, baseline: Baseline, limit: float) -> Case:
        ours = _detector(slice_frames, RunwayDetectorParameters())
        return Case('runway 320x240 rows 50-130', ours, name, _in_turn(baseline, slices), limit)

    cases = [in_rows('OpenCV', _opencv, 1.5)]
    if importlib.util.find_spec('skimage') is not None:
        cases.append(in_rows('scikit-image', _scikit_image(), 0.2))
    ours, theirs = _detector(whole_frames, whole), _in_turn(_opencv, wholes)
    return [*cases, Case('runway 1280x720 whole frame', ours, 'OpenCV', theirs)]


def _detector(frames: list[Frame], parameters: RunwayDetectorParameters) -> Action:
    detector = RunwayDetector(parameters)
    endless = itertools.cycle(frames)
    return lambda: detector.process(next(endless), 0)


def _in_turn(process: Baseline, slices: list[Frame]) -> Action:
    endless = itertools.cycle([(gray, automatic_threshold(gray)) for gray in slices])
    return lambda: process(*next(endless))


def _opencv(gray: Frame, threshold: float) -> object:
    x = cv2.Sobel(gray, cv2.CV_32F, 1, 0, borderType=cv2.BORDER_REPLICATE)
    y = cv2.Sobel(gray, cv2.CV_32F, 0, 1, borderType=cv2.BORDER_REPLICATE)
    limit = threshold * _KERNEL_SUM_AND_SCALE
    edges = (cv2.magnitude(x, y) > limit).view(np.uint8)
    opened = cv2.morphologyEx(edges, cv2.MORPH_OPEN, _VERTICAL)
    return cv2.HoughLines(opened, 2, np.pi / 180, 15)


def _scikit_image() -> Baseline:
    # Its functions have no types; as modules of unknown type they need none.
    filters, morphology, transform = (
        importlib.import_module(f'skimage.{name}')
        for name in ('filters', 'morphology', 'transform')
    )
    angles = np.deg2rad(np.arange(-90.0, 90.0))

    def process(gray: Frame, threshold: float) -> object:
        # Its kernels are divided by 4, and its magnitude is the root of both squares' mean.
        edges = filters.sobel(gray / 255) / math.sqrt(2) > threshold
        opened = morphology.opening(edges, _VERTICAL)
        votes, theta, rho = transform.hough_line(opened, angles)
        return transform.hough_line_peaks(votes, theta, rho, 5, 5, 15, 3)

    return process


def _runway(width: int, height: int, seed: int) -> Frame:
    """A runway with three painted lines to the horizon, soft grass texture and sensor noise."""
    random = np.random.default_rng(seed)
    scale = height / 240
    grass = random.integers(0, 40, (height // 4, width // 4, 3), dtype=np.uint8)
    texture = cv2.resize(grass, (width, height), interpolation=cv2.INTER_CUBIC)
    frame = np.array(texture, np.uint8) + np.array([30, 90, 40], np.uint8)
    horizon = round((35 + random.uniform(-3, 3)) * scale)
    frame[:horizon] = (220, 190, 170)
    apex = width / 2 + random.uniform(-6, 6) * scale, horizon - 10 * scale

    def strip(left: float, right: float, color: tuple[int, int, int]) -> None:
        corners = [apex, (width / 2 + left * scale, height), (width / 2 + right * scale, height)]
        points = np.round(np.array(corners) * 16).astype(np.int32)
        cv2.fillPoly(frame, [points], color, cv2.LINE_AA, 4)

    strip(-64, 64, (100, 100, 100))
    for left, right in ((-64, -56), (-4, 4), (56, 64)):
        strip(left, right, (225, 225, 225))
    # Nothing in the frame is brighter than 225: the sum stays within 8 bits.
    return frame + random.integers(0, 9, frame.shape, dtype=np.uint8)

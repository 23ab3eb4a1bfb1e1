"""The runway detector over labelled images."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.offline.evaluation.corners import (
    TOLERANCE,
    WARM_UP,
    CornersError,
    CornersScore,
    LabelledFrame,
    Tolerance,
    score_frame,
)
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.vision.approach.attitude import HorizonLine
from mvuav_ros.vision.approach.detector import ApproachDetector
from mvuav_ros.vision.approach.overlay import draw_approach
from mvuav_ros.vision.approach.results import ApproachResult
from mvuav_ros.vision.runway.debug_images import draw_overlay
from mvuav_ros.vision.runway.detector import RunwayDetector
from mvuav_ros.vision.runway.results import RunwayResult

FRAME_RATE = 25
_LABEL = (255, 255, 255)
_PICTURE_WIDTH = 960


@dataclass(frozen=True)
class LabelledRun:
    """Images of one flight with their labels.

    Attributes:
        folder: where the images lie.
        frames: the labels, in order.
        horizon: of each frame, as an attitude sensor would know it; None without one.
        gray: the images are turned grey first.
        allowed: how far edges may be from their labels.
    """

    folder: Path
    frames: Sequence[LabelledFrame]
    horizon: Sequence[HorizonLine] | None = None
    gray: bool = False
    allowed: Tolerance = TOLERANCE


def run_detector(
    run: LabelledRun, parameters: RunwayDetectorParameters, tick: Callable[[], None]
) -> CornersScore:
    """Process the images of a run in order; ``tick`` is called after each.

    Raises:
        CornersError: an image cannot be read.
    """
    scores = []
    for frame, result in _results(run, parameters):
        scores.append(score_frame(frame, result.lines, run.allowed))
        tick()
    return CornersScore(tuple(scores))


def write_images(
    run: LabelledRun, parameters: RunwayDetectorParameters, score: CornersScore, folder: Path
) -> list[Path]:
    """Draw overlays, with the labels in white, of the best, the median and the worst frame.

    Returns:
        The files ``best.png``, ``median.png``, ``worst.png`` and, of each class of failure that
        there is, its worst frame as ``failure_CLASS.png``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    ranked = sorted(range(WARM_UP, len(run.frames)), key=lambda index: score.frames[index].error)
    if not ranked:
        return []
    wanted = {'best': ranked[0], 'median': ranked[len(ranked) // 2], 'worst': ranked[-1]}
    for index in ranked:
        if failure := score.frames[index].failure:
            wanted[f'failure_{failure}'] = index
    written = []
    for index, (frame, result) in enumerate(_results(run, parameters)):
        for name in (name for name, at in wanted.items() if at == index):
            path = folder / f'{name}.png'
            if not cv2.imwrite(str(path), _image(frame, result)):
                raise CornersError(f'{path}: cannot be written')
            written.append(path)
    return written


def _results(
    run: LabelledRun, parameters: RunwayDetectorParameters
) -> Iterator[tuple[LabelledFrame, RunwayResult | ApproachResult]]:
    thesis = RunwayDetector(replace(parameters, mode='thesis'))
    approach = ApproachDetector(parameters)
    flag = cv2.IMREAD_GRAYSCALE if run.gray else cv2.IMREAD_COLOR
    for index, frame in enumerate(run.frames):
        path = run.folder / frame.file
        image = cv2.imread(str(path), flag)
        if image is None:
            raise CornersError(f'{path}: no image that can be read')
        pixels: NDArray[np.uint8] = np.asarray(image, np.uint8)
        stamp_ns = round(index * 1e9 / FRAME_RATE)
        if parameters.mode == 'approach':
            attitude = None if run.horizon is None else run.horizon[index]
            yield frame, approach.process(pixels, stamp_ns, attitude)
        else:
            yield frame, thesis.process(pixels, stamp_ns)


def _image(frame: LabelledFrame, result: RunwayResult | ApproachResult) -> NDArray[np.uint8]:
    image = draw_overlay(result) if isinstance(result, RunwayResult) else draw_approach(result)
    factor = max(1, round(_PICTURE_WIDTH / image.shape[1]))
    image = np.asarray(
        cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_NEAREST), np.uint8
    )
    corners = np.array([frame.near_left, frame.near_right, frame.far_right, frame.far_left])
    outline = (corners + 0.5) * factor - 0.5
    cv2.polylines(image, [np.rint(outline).astype(np.int32)], True, _LABEL, 1)
    return image

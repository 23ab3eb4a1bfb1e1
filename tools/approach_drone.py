"""Real footage from drones over a runway, all of it kept back: no fit has seen it as a runway.

Frames of the UAV clip that do not show its runway are in the fit.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from approach_rows import Pixels, Row, Timed, judged
from numpy.typing import NDArray

from mvuav_ros.offline.evaluation.corners import LabelledFrame, Tolerance, score_frame

ALLOWED = Tolerance(6.0, 0.05)
UAV_RUNWAY = range(120, 456)
"""Frames of the UAV clip that may show its runway."""
STILLS = 0, 2, 10, 12, 14, 16
"""Of the model airfield: those in which both edges of the runway are in view."""
MARGIN = 4
"""Px by which a still is moved, as no camera stands still."""
CORNERS: dict[int, tuple[tuple[float, float], ...]] = {
    190: ((281, 479), (407, 479), (346, 297), (292, 297)),
    200: ((284, 479), (412, 479), (339, 314), (283, 318)),
    210: ((288, 479), (402, 471), (321, 351), (263, 362)),
    225: ((290, 479), (409, 479), (341, 368), (280, 377)),
    240: ((263, 479), (389, 477), (314, 321), (255, 327)),
    255: ((235, 479), (370, 479), (271, 350), (219, 378)),
    270: ((240, 479), (357, 478), (301, 377), (235, 387)),
    285: ((217, 479), (328, 479), (286, 402), (215, 419)),
    390: ((231, 478), (351, 478), (336, 387), (248, 386)),
}
"""Near left, near right, far right and far left in frames of the UAV clip, by hand, good to 3 px;
the near ones are where the picture ends."""


def uav(path: Path, *, gray: bool) -> Row:
    """The labelled frames of a fixed-wing UAV that flies over a short runway and turns."""
    row, detector = Row(f'UAV {"grey" if gray else "colour"}', warm_up=0), Timed()
    clip = cv2.VideoCapture(str(path))
    for index in range(max(CORNERS) + 1):
        image = _seen(np.asarray(clip.read()[1]), gray=gray)
        result = detector.process(image)
        if index in CORNERS:
            error = score_frame(LabelledFrame('', *CORNERS[index]), result.lines, ALLOWED).error
            row.frames.append(judged(str(index), detector, result, error))
    return detector.put(row)


def model_airfield(folder: Path, frames: int, *, gray: bool) -> Row:
    """Stills from a few metres above a model airfield's runway, each shown so many times."""
    row = Row(f'model airfield {"grey" if gray else "colour"}', warm_up=0)
    for number in STILLS:
        image = _seen(cv2.imread(str(folder / f'image_{number}.png')), gray=gray)
        mask = cv2.imread(str(folder / f'mask_{number}.png'), cv2.IMREAD_GRAYSCALE) > 0
        height, width = (side - 2 * MARGIN for side in mask.shape)
        detector, rng = Timed(), np.random.default_rng(number)
        for _ in range(frames):
            x, y = rng.integers(0, 2 * MARGIN + 1, 2)
            part = slice(y, y + height), slice(x, x + width)
            result = detector.process(np.ascontiguousarray(image[part]))
        error = score_frame(label_of(mask[part]), result.lines, ALLOWED).error
        row.frames.append(judged(str(number), detector, result, error))
        detector.put(row)
    return row


def _seen(image: Pixels, *, gray: bool) -> Pixels:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)) if gray else image


def label_of(mask: NDArray[np.bool_]) -> LabelledFrame:
    """Corners of the straight edges of a mask, as far down as either of them is in view."""
    rows = np.flatnonzero(mask.any(axis=1))
    columns = mask[rows].argmax(axis=1), mask.shape[1] - 1 - mask[rows, ::-1].argmax(axis=1)
    lines: list[NDArray[Any]] = []
    last = 0
    for side in columns:
        fits = inside = (side > 3) & (side < mask.shape[1] - 4)
        for _ in range(4):
            line = np.polyfit(rows[fits], side[fits], 1)
            fits = inside & (np.abs(np.polyval(line, rows) - side) < 4)
        lines.append(line)
        last = max(last, int(rows[fits].max()))
    (left, right), (far_left, far_right) = (
        [(float(np.polyval(line, row)), float(row)) for line in lines]
        for row in (last, int(rows[0]))
    )
    return LabelledFrame('', left, right, far_right, far_left)

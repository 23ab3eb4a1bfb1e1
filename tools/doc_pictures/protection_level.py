"""Solution separation on one frame with a light that is wrong."""

from __future__ import annotations

from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Rectangle

from doc_pictures.style import BLUE, GRAY, GREEN, INK, ORANGE, save
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY
from mvuav_ros.vision.integrity import protection_levels
from mvuav_ros.vision.rig import TANKER_747

_PUSH = (2.4, -1.6)
"""px, of the wrong light."""
_WRONG = 4


def protection_level(path: Path) -> None:
    """The pose, the poses without one light each, the truth, and the level, seen from above."""
    camera = CameraModel(640, 480, k=(600, 0, 320, 0, 600, 240, 0, 0, 1))
    dock = np.array(TANKER_747.dock)
    truth = np.array((0.0, 0.0, 120.0))
    rvec = cv2.Rodrigues(OPTICAL_FROM_BODY)[0]
    place = (truth - OPTICAL_FROM_BODY @ dock).reshape(3, 1)
    pixels = cv2.projectPoints(TANKER_747.positions, rvec, place, camera.matrix, None)[0][:, 0]
    pixels += np.random.default_rng(3).normal(0.0, 0.1, pixels.shape)
    pixels[_WRONG] += _PUSH
    figure, axis = plt.subplots(figsize=(8.6, 4.2))
    everything = list(range(5))
    for left_out in (None, *everything):
        used = [light for light in everything if light != left_out]
        turn, moved = cv2.solvePnPRefineLM(
            TANKER_747.positions[used], pixels[used], camera.matrix, None, rvec.copy(), place.copy()
        )
        rotation = cv2.Rodrigues(turn)[0]
        x, _, z = (moved.ravel() + rotation @ dock).tolist()
        if left_out is None:
            levels = protection_levels(
                camera, TANKER_747, everything, pixels, rotation, moved.ravel(), 0.1
            )
            corner = (z - levels.along, x - levels.across)
            size = (2 * levels.along, 2 * levels.across)
            axis.add_patch(Rectangle(corner, *size, color=BLUE, alpha=0.12, lw=0))
            axis.add_patch(Rectangle(corner, *size, fill=False, edgecolor=BLUE, lw=2))
            axis.plot(z, x, 'o', color=BLUE, ms=10, label='published pose')
            axis.text(corner[0] + 0.08, corner[1] + 0.03, 'protection level', color=BLUE)
        else:
            is_wrong = left_out == _WRONG
            color = ORANGE if is_wrong else GRAY
            label = 'pose without the right wing' if is_wrong else 'poses without another light'
            axis.plot(z, x, 's', color=color, ms=7, label=label)
    axis.plot(truth[2], truth[0], '*', color=GREEN, ms=15, label='truth')
    handles = dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True))
    axis.legend(handles.values(), handles.keys(), loc='upper left', fontsize=9)
    axis.set_xlabel('along the line of sight [m]', color=INK)
    axis.set_ylabel('across [m]', color=INK)
    axis.set_title('The right wing is seen 2.9 px beside its place', loc='left', fontsize=10)
    axis.margins(0.12)
    axis.grid(alpha=0.3)
    save(figure, path)

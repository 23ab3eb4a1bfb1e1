"""Pieces found in the rows that have any, as OpenCV finds them in the whole frame."""

import cv2
import numpy as np
import pytest

from mvuav_ros.vision.markers.lights import label


def masks(seed):
    """Lights, lines, specks and noise, few and many, in frames of any size."""
    rng = np.random.default_rng(seed)
    for size in ((480, 640), (120, 160), (97, 131), (1, 8), (2, 3), (33, 1)):
        mask = np.zeros(size, np.uint8)
        for _ in range(int(rng.integers(0, 12))):
            centre = int(rng.integers(size[1])), int(rng.integers(size[0]))
            cv2.circle(mask, centre, int(rng.integers(0, 7)), 255, -1)
        yield mask
        ends = [(int(rng.integers(size[1])), int(rng.integers(size[0]))) for _ in range(2)]
        yield cv2.line(mask.copy(), *ends, 255, 1)
        for share in (0.0005, 0.01, 0.3):
            yield np.where(rng.random(size) < share, 255, 0).astype(np.uint8)
        yield np.where(rng.random((size[0], 1)) < 0.1, mask | 255, 0).astype(np.uint8)
        # A part of a wider frame, as a cut one has.
        yield np.where(rng.random((size[0], size[1] + 9)) < 0.001, 255, 0).astype(np.uint8)[:, 4:-5]


@pytest.mark.parametrize('seed', range(12))
def test_the_same_pieces_in_the_same_order(seed):
    for mask in masks(seed):
        numbers, where, stats = label(mask)
        count, expected, boxes, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
        assert len(stats) == count
        assert (stats[1:] == boxes[1:]).all()
        assert (numbers[where] == expected).all()


def test_bright_and_dark_frames():
    for value in (0, 255):
        mask = np.full((48, 64), value, np.uint8)
        numbers, where, stats = label(mask)
        assert (numbers[where] == value // 255).all() and len(stats) == 1 + value // 255

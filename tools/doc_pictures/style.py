"""What all pictures share: colours, rows of images, and files that do not change by themselves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill

import cv2
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

INK, BLUE, GREEN, RED, ORANGE, GRAY = (
    '#222222',
    '#1f5fbf',
    '#2a8f3c',
    '#c23030',
    '#c77400',
    '#888888',
)
_JPEG = {'quality': 82, 'subsampling': 0}
"""Photographs with text: a third of a PNG's size."""

plt.rcParams.update(
    {
        'svg.hashsalt': 'mvuav_ros',
        'svg.fonttype': 'path',
        'font.size': 11,
        'figure.facecolor': 'white',
    }
)


def save(figure: Figure, path: Path) -> None:
    """Write a figure without the date, so that the same picture is the same file."""
    if path.suffix == '.svg':
        figure.savefig(path, metadata={'Date': None}, bbox_inches='tight')
        plt.close(figure)
        return
    figure.savefig(path, dpi=170, bbox_inches='tight', pil_kwargs=_JPEG)
    plt.close(figure)


def image_row(
    images: Sequence[np.ndarray], titles: Sequence[str], *, columns: int = 2, width: float = 5.2
) -> Figure:
    """Images with a title above each; grey ones as they are, others blue, green, red.

    Two columns and this width make the titles legible on a telephone too.
    """
    rows = -(-len(images) // columns)
    lines = [fill(title, 27) for title in titles]
    height, wide = images[0].shape[:2]
    tall = width / columns * height / wide + 0.3 + 0.2 * max(line.count('\n') for line in lines)
    figure, axes = plt.subplots(rows, columns, figsize=(width, rows * tall), squeeze=False)
    for axis in axes.flat:
        axis.axis('off')
    for axis, image, title in zip(axes.flat, images, lines, strict=False):
        shown = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
        axis.imshow(shown, cmap='gray', vmin=0, vmax=255, interpolation='antialiased')
        axis.set_title(title, fontsize=10.5, color=INK)
    figure.tight_layout(pad=0.3)
    return figure

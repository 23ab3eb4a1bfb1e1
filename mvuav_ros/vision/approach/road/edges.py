"""The edges of a strip of known contrast on the frame itself."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.edges import Edges, LevelledFrame, Strip, sample_edges
from mvuav_ros.vision.approach.road.features import PLAIN, Colours, features_of

_COLOUR_SMOOTHING = 13
"""Samples across an edge, to find its line in: JPEG rounds colour coarsely."""


def find_edges(
    frame: LevelledFrame,
    strip: Strip,
    contrast: NDArray[np.float64],
    brightness: float,
    colours: Colours = PLAIN,
) -> Edges:
    """Measure the edges of a strip whose inside has a contrast (channels,) to its outside.

    ``brightness`` is its weight against colourfulness; the contrast was measured with ``colours``.
    """
    sampled = sample_edges(frame, strip)
    weights = np.array([brightness, 1.0])
    weighted = contrast * weights
    size = float(np.hypot(*weighted))
    direction = weighted * weights / max(size, 1e-6)

    def steps_of(smoothing: int) -> NDArray[Any]:
        features = features_of(sampled.pixels, colours, smoothing)
        profile = direction[0] * features[0] + direction[1] * features[1]
        clipped: NDArray[Any] = np.clip(sampled.steps(profile), 0.0, size)
        return clipped

    # Noise of colour hides the line, smoothing it moves the steps: each for what it leaves alone.
    return sampled.fit(steps_of(1), steps_of(_COLOUR_SMOOTHING), size)

"""The runway's two edges on the frame itself: steps of brightness and colour, or painted lines."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.channels import opponent_channels
from mvuav_ros.vision.approach.edges import (
    Edges,
    EdgeSamples,
    LevelledFrame,
    Strip,
    sample_edges,
)
from mvuav_ros.vision.approach.numeric import in_common

_LEAST_CONTRAST = 1.5
"""Grey levels: less contrast of the surface gives no direction."""
_PAINT_BEFORE_STEPS = 1.0
"""Paint must be that much more evident than steps, in textures, before edges are looked for in it:
a runway's edge is the pavement's, where that can be seen."""
_CLEAR_CONTRAST = 12.0
"""Grey levels of contrast that are plain to see."""
_COLOUR_CONTRAST = 30.0
"""Grey levels of the opponent colours between pavement and grass by day; at dusk, or where JPEG has
blurred weak colours, less. Run 3 and the simulator's flights."""
_MEMORY = 0.2
_REGION = 5
"""Share of the samples across an edge, at either end, that are its outside and its inside."""


class EdgeLook:
    """What the step across a runway's edges is like, learnt from frame to frame.

    Attributes:
        paint_lead: by how much paint is more evident than steps, in textures.
    """

    def __init__(self) -> None:
        self.paint_lead = 0.0
        self._contrast = np.zeros(3)
        self._paint = 0.0
        self._known = False

    @property
    def clear(self) -> bool:
        """Pavement and land differ so much that every frame shows the edges."""
        return float(np.linalg.norm(self._contrast)) > _CLEAR_CONTRAST

    @property
    def coloured(self) -> bool:
        """Their colours alone tell them apart: the edge is the pavement's, not a line's."""
        return float(np.linalg.norm(self._contrast[1:])) > _COLOUR_CONTRAST

    def find(self, frame: LevelledFrame, strip: Strip, *, wide: bool) -> Edges:
        """Measure both edges of a strip, and learn what they look like.

        Those of a wide one may be farther from the strip's than its lines are apart.
        """
        samples = sample_edges(frame, strip)
        channels = opponent_channels(samples.pixels)
        steps = np.stack([samples.steps(channel) for channel in channels])
        self._learn(steps, samples, channels, wide)
        if self.paint_lead > _PAINT_BEFORE_STEPS:
            ridge = _ridges(samples, channels[0])
            size = max(self._paint, _LEAST_CONTRAST)
            lines = np.clip(ridge, 0.0, size)
            return samples.fit(lines, lines, size)
        contrast = self._contrast[: len(channels)].copy()
        colour = float(np.linalg.norm(contrast[1:]))
        if wide and contrast[0] < 0 and colour > max(_CLEAR_CONTRAST, -float(contrast[0])):
            # White stripes along the edge of dark pavement would count as land.
            contrast[0] = 0.0
        size = float(np.linalg.norm(contrast))
        direction = contrast / max(size, 1e-6)
        along = np.tensordot(direction, steps, axes=1)
        size = max(size, _LEAST_CONTRAST)
        along = np.clip(along, 0.0, size)
        return samples.fit(along, along, size)

    def _learn(
        self,
        steps: NDArray[Any],
        samples: EdgeSamples,
        channels: list[NDArray[np.float32]],
        wide: bool,
    ) -> None:
        """Take the strongest step that both edges have in common near where they are expected."""
        middle = steps.shape[3] // 2
        near = slice(max(0, middle - 3), middle + 4)
        if wide:
            left, right = _regions(samples, channels)
        else:
            average = steps.mean(axis=2)[:, :, near]
            size = np.linalg.norm(average, axis=0)
            left = average[:, 0, size[0].argmax()]
            right = average[:, 1, size[1].argmax()]
        # The contrast is what the two edges agree in.
        common = in_common(left, right)
        contrast = np.zeros(3)
        contrast[: common.size] = common
        paint = float(_ridges(samples, channels[0]).mean(axis=1)[:, near].max())
        share = _MEMORY if self._known else 1.0
        self._contrast += share * (contrast - self._contrast)
        self._paint += share * (paint - self._paint)
        self._known = True


def _regions(
    samples: EdgeSamples, channels: list[NDArray[np.float32]]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Inside minus outside, farthest from either edge: lines beside the edge do not count."""
    rows = samples.rows.size
    outer = max(1, samples.across.size // _REGION)
    values = np.stack([channel.reshape(2, rows, -1).mean(axis=1) for channel in channels])
    first, last = values[:, :, :outer].mean(axis=2), values[:, :, -outer:].mean(axis=2)
    rise = last - first
    return rise[:, 0], -rise[:, 1]


def _ridges(samples: EdgeSamples, brightness: NDArray[Any]) -> NDArray[Any]:
    """(2, count, places - base) how much brighter a place is than both sides, grey levels."""
    half = samples.base // 2
    sides = np.maximum(brightness[:, : -2 * half], brightness[:, 2 * half :])
    return samples.by_side(np.maximum(brightness[:, half:-half] - sides, 0.0))

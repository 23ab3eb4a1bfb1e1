"""One strip followed from frame to frame."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.channels import Table
from mvuav_ros.vision.approach.edges import Edges, LevelledFrame, Strip, sample_edges
from mvuav_ros.vision.approach.followed_strip import FollowedStrip
from mvuav_ros.vision.approach.road.features import PLAIN, Colours, features_of
from mvuav_ros.vision.approach.road.strip import score_strips
from mvuav_ros.vision.approach.road.targets import EdgeProfile, Target

_MEMORY = 0.15
"""Share of the newest frame in what a track remembers of its looks."""
_HORIZON_SIGMA = 4.0
"""Px of the working image: of the vanishing point about the horizon."""
_COLOUR_SMOOTHING = 13
"""Samples across an edge, to find its line in: JPEG rounds colour coarsely."""
_SUPPORT_RANGE, _LEAST_SHARP = 0.25, 0.2
_OFF_HORIZON = 7.0
"""Px of the working image between the horizon seen and where the edges meet; beyond, less and
less likely."""
_HIGH, _LOW = 0.6, 0.8
"""Share of the image's height at which a strip under the camera ends: of no road, of any."""
_CONVINCING, _CERTAIN = 7.0, 10.0
"""Sums of merit above the target's ``start_score``."""
_LEAST_AGE = 8
_FADES = 0.8
_WIDTH_SPREAD = 0.6
"""Natural logarithm."""


class View(NamedTuple):
    """A frame as the tracks see it.

    Attributes:
        frame: the frame itself.
        table: row sums of the levelled working image's features.
        horizon_row: of the levelled working image, px, if it is seen.
        look: of the target, on this land.
        colours: with which the features were made.
    """

    frame: LevelledFrame
    table: Table
    horizon_row: float | None
    look: EdgeProfile
    colours: Colours


class Track(FollowedStrip):
    """A strip, what it looks like, and how well it has done.

    Attributes:
        contrast: (channels,) inside minus outside.
        quality: strip score times the support of the edges, averaged over the last frames.
        merit: the same, less for what is unusual.
        evidence: sum of merit above the target's ``start_score``, limited.
    """

    MOST_MISSES = 10

    def __init__(self, target: Target, strip: Strip, contrast: NDArray[np.float64]) -> None:
        super().__init__(strip)
        self.target = target
        self.contrast = contrast
        self.quality = self.merit = self.evidence = 0.0

    @property
    def width(self) -> float:
        """Of the near end, px of the levelled working image."""
        left, right = self.shape.slopes
        return (right - left) * self.near

    def same_as(self, other: Track) -> bool:
        """Whether both are the same strip on the ground."""
        width = min(self.width, other.width)
        (middle, row), (its_middle, its_row) = self._near_end(), other._near_end()
        return (
            abs(middle - its_middle) < 0.4 * width
            and max(self.width, other.width) < 1.5 * width
            and abs(row - its_row) < 0.5 * width + 4
        )

    def _near_end(self) -> tuple[float, float]:
        x, y, left, right, _, near = (float(value) for value in self.strip())
        return x + 0.5 * (left + right) * near, y + near

    def step(self, view: View) -> None:
        """Follow it into the next frame."""
        self.age += 1
        shape, target = self.shape, self.target
        shape.predict()
        strip = self.strip()
        if not np.isfinite(strip).all():
            self.give_up()
            return
        edges = find_edges(view.frame, strip, self.contrast, target.look.brightness, view.colours)
        left, right = (edge.support for edge in edges)
        # A pipeline's edge may be hidden on one side.
        support = math.sqrt(left * right) if view.look.painted else 0.5 * (left + right)
        shape.move_reference(strip[1] + 0.7 * self.near + 0.3 * self.far)
        row = view.horizon_row
        shape.update(edges, None if row is None else (row, _HORIZON_SIGMA))
        strip = self.strip()
        if not self._plausible(strip, view.table):
            self.give_up()
            return
        scores = score_strips(view.table, strip[None, :4], view.look)
        sharp = min(max((support - target.least_support) / _SUPPORT_RANGE, 0.0), 1.0)
        credible = self._credibility(strip[1], row, view.table.shape[1])
        score = float(scores.score[0]) * sharp * credible
        self.quality += max(_MEMORY, 1.0 / self.age) * (score - self.quality)
        self.merit = self.quality * self._likelihood()
        seen = score > 0.5 * target.keep_score and sharp > _LEAST_SHARP
        self.points = edges if seen else None
        self.misses = 0 if seen else self.misses + 1
        if seen:
            self.contrast = self.contrast + _MEMORY * (scores.contrast[0] - self.contrast)
            self.follow_ends(float(scores.far[0]), float(scores.near[0]))
            self.open_end = bool(scores.open_end[0])

    def weigh(self, *, steady: bool) -> None:
        """Let the newest frame speak for or against the track; in a turn only against it."""
        change = self.merit - self.target.start_score
        if steady or change < 0:
            self.evidence = min(max(self.evidence + change, 0.0), _CERTAIN)

    @property
    def believed(self) -> bool:
        """Enough frames have spoken for it."""
        return self.evidence >= _CONVINCING and self.age >= _LEAST_AGE

    @property
    def certain(self) -> bool:
        """So many frames have spoken for it that more would not count."""
        return self.evidence >= _CERTAIN

    @property
    def confidence(self) -> float:
        """0 to 1: one half where it is just believed, less while it is not seen."""
        return self.quality / (self.quality + 1.0) * _FADES**self.misses

    def _plausible(self, strip: Strip, table: Table) -> bool:
        if not np.isfinite(strip).all():
            return False
        x, y, left, right = (float(v) for v in strip[:4])
        width = right - left
        aside = abs(left + right) / 2 / max(width, 1e-6)
        height, columns = table.shape[1], table.shape[2] - 1
        return (
            0.03 < width < self.target.widest
            and aside < self.target.farthest_aside
            and -0.5 * columns < x < 1.5 * columns
            and -0.5 * height < y < height - 4
        )

    def _credibility(self, y: float, horizon_row: float | None, height: int) -> float:
        """1 for what a strip on the ground must look like, down to 0."""
        off = 0.0
        if horizon_row is not None:
            off = max(0.0, abs(y - horizon_row) / _OFF_HORIZON - 1.0)
        reached = (y + self.near) / height
        return math.exp(-0.5 * off**2) * min(max((reached - _HIGH) / (_LOW - _HIGH), 0.0), 1.0)

    def _likelihood(self) -> float:
        """1 for the usual offsets and widths, less beyond."""
        left, right = self.shape.slopes
        target, width = self.target, max(right - left, 1e-6)
        aside = max(0.0, abs(left + right) / 2 / width - target.usual_offset)
        narrow, usual = target.usual_widths
        wide = max(0.0, math.log(width / usual), math.log(narrow / width)) / _WIDTH_SPREAD
        return math.exp(-0.5 * ((aside / target.offset_spread) ** 2 + wide**2))


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

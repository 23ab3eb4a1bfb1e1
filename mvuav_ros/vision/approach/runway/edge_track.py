"""A runway followed by its edges on the frame itself: by its pavement, and by lines beside it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.edges import Edges, LevelledFrame, Strip
from mvuav_ros.vision.approach.followed_strip import FollowedStrip
from mvuav_ros.vision.approach.registration import Registration
from mvuav_ros.vision.approach.runway.candidates import LevelledImage, ends_of
from mvuav_ros.vision.approach.runway.edges import EdgeLook
from mvuav_ros.vision.approach.runway.lined_edges import LinedEdges
from mvuav_ros.vision.approach.runway.shoulders import shows_shoulders

MEMORY = 0.06
"""Share of a weighed frame in what a track remembers."""
YOUNG = 5
"""Frames in which a track is weighed every time."""
_LEAST_TOLERANCE, _TOLERANCE_SHARE = 3.0, 0.05
"""Px of the working image, and widths: strips whose corners are that near the mean agree with it.
So far from the labels a report still counts as right."""
WIDE, LEAST_SUPPORT = 18.0, 0.25
"""Px of the near end from which a runway's lines are so far apart that its edges are those with the
clearest steps, and their support, 0 to 1, from which that holds. The simulator's flights."""
_GROWTH_MEMORY, _MOST_GROWTH = 0.1, 0.04
_SHOULDER_MEMORY, _SHOULDERS = (0.3, 0.1), (0.3, 0.6)
"""Share of a frame that shows shoulders, and of one that does not, in what is remembered of them,
and what of it makes them possible and certain. Run 3."""
_JUMP_MEMORY = 0.15
"""Share of a frame by which an edge that jumped is forgotten."""


class View(NamedTuple):
    """A frame as the tracks see it.

    Attributes:
        frame: the frame itself.
        working: its working image, levelled.
        horizon: row of the vanishing point and its standard deviation, if known, px.
        registration: of the working images.
    """

    frame: LevelledFrame
    working: LevelledImage
    horizon: tuple[float, float] | None
    registration: Registration


def tolerance(width: float) -> float:
    """Px by which an edge may be wrong where the near end is so many px wide."""
    return max(_LEAST_TOLERANCE, _TOLERANCE_SHARE * width)


def support(edges: Edges) -> float:
    """Of the less certain edge, 0 to 1."""
    return min(edge.support for edge in edges)


class EdgeTrack(FollowedStrip):
    """A runway's edges, and what is known of how they look.

    Attributes:
        distinct: share of the last frames with clear lines along both sides, or clear colours.
        shoulders: share of the last frames in which pavement is seen to go on beyond both edges.
    """

    def __init__(self, strip: Strip) -> None:
        super().__init__(strip)
        self.distinct = self.shoulders = 0.0
        self._look, self._lines = EdgeLook(), LinedEdges()
        self._clear = False
        self._jumped = self._growth = 0.0

    @property
    def other_edges(self) -> float:
        """Odds that an edge is elsewhere: 1, even, where the image shows two places for it.

        It is so with paved shoulders that are plain to see, and after an edge has jumped.
        """
        shoulders = float(np.interp(self.shoulders, _SHOULDERS, (0.0, 1.0)))
        return max(shoulders, self._jumped, self._lines.other)

    @property
    def shoulder_lines(self) -> float:
        """From 0 to 1, whether shoulders have lines too, on both sides and as far apart."""
        return self._lines.shoulders

    def predict(self, view: View) -> None:
        """Where it is expected in the next frame."""
        self.shape.grow(self._growth)
        self.shape.predict(*view.registration.shift(self.strip(), view.frame.level))

    def follow_edges(self, view: View) -> bool:
        """Follow a wide runway by its edges alone; whether they are seen."""
        strip = self.strip()
        exact = self.seen_edges(view, wide=True)
        if exact is None:
            self.points = None
            return False
        # The lines' outer sides are the edges, by colour too: shoulders may lie beyond.
        if self._look.coloured:
            self._lines.expect_colour(strip, exact)
        exact = self._lines_along(view, strip) or exact
        self._update(exact, float(strip[1] + 0.3 * self.far + 0.7 * self.near))
        left, right = self.shape.slopes
        change = (right - left) / (strip[3] - strip[2]) - 1.0
        growth = self._growth + _GROWTH_MEMORY * change
        self._growth = min(max(growth, -_MOST_GROWTH), _MOST_GROWTH)
        shown = shows_shoulders(view.frame, self.strip())
        if shown is not None:
            self.shoulders += _SHOULDER_MEMORY[not shown] * (float(shown) - self.shoulders)
        return True

    def see_ends(self, view: View) -> None:
        """See where it ends in the newest frame."""
        strip = self.strip()
        found = ends_of(view.working, strip)
        if found is None:
            return
        if found[1] > 0.5 * self.near:
            self._ends_at(strip[1] + found)
        middle = strip[0] + 0.5 * (strip[2] + strip[3]) * self.near
        _, last = view.frame.level.to_frame(middle, strip[1] + self.near)
        self.open_end = bool(last > view.frame.image.shape[0] - 2 * view.frame.level.factor)

    def seen_edges(self, view: View, *, wide: bool) -> Edges | None:
        """Both edges by the pavement's, where they were followed, if they are seen there."""
        exact = self._look.find(view.frame, self.strip(), wide=wide)
        return None if support(exact) < LEAST_SUPPORT else exact

    def by_lines(self, view: View, about: Strip) -> Edges | None:
        """Both edges by the lines along them, where colour does not show them."""
        coloured = self._clear and self._look.coloured
        if coloured:
            self._lines.forget()
        found = None if coloured else self._lines_along(view, about)
        distinct = float(coloured or found is not None)
        self.distinct += max(MEMORY, 1.0 / self.age) * (distinct - self.distinct)
        return found

    def _lines_along(self, view: View, about: Strip) -> Edges | None:
        strip = self.strip()
        allowed = tolerance(float((strip[3] - strip[2]) * strip[5]))
        return self._lines.find(view.frame, strip, about, allowed)

    def known_span(self, strip: Strip) -> Strip:
        """A strip whose lines are measured to the near end as known from earlier frames, too.

        What is measured in the far part of a runway alone is wrong at its near end.
        """
        _, y = self.shape.vanishing_point
        if self.age <= YOUNG or not math.isfinite(y):
            return strip
        down = y - float(strip[1])
        ends = max(self.far + down, 1.0), max(self.near + down, float(strip[5]))
        return np.array([*strip[:4], *ends])

    def take_in(self, points: Edges, rows: NDArray[np.float64], view: View) -> None:
        """Take in edges between two rows, which may show that an edge has jumped."""
        self._watch(points)
        self._update(points, float(0.3 * rows[0] + 0.7 * rows[1]), view.horizon)

    def _update(
        self, points: Edges, row: float, horizon: tuple[float, float] | None = None
    ) -> None:
        self.points = points
        self.shape.move_reference(row)
        self.shape.update(points, horizon)

    def _watch(self, points: Edges) -> None:
        """Whether an edge is farther from where it was than the tolerance."""
        x, y, *slopes, _, near = (float(value) for value in self.strip())
        allowed = tolerance((slopes[1] - slopes[0]) * near)
        self._jumped *= 1.0 - _JUMP_MEMORY
        if self.age <= YOUNG:
            return
        for edge, slope in zip(points, slopes, strict=True):
            nearer = (edge.rows - edge.rows.mean() >= 0) & (edge.weights > 0)
            if nearer.any():
                away = edge.columns[nearer] - x - slope * (edge.rows[nearer] - y)
                if abs(float(away.mean())) > allowed:
                    self._jumped = 1.0

    def _ends_at(self, rows: NDArray[np.float64]) -> None:
        _, y = self.shape.vanishing_point
        self.follow_ends(max(float(rows[0]) - y, 1.0), float(rows[1]) - y)

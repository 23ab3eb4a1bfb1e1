"""One frame in which not all markers are where and as they should be."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from mvuav_ros.vision.markers.appearance import AppearanceModel
from mvuav_ros.vision.markers.assignment import (
    Clutter,
    Expectation,
    Lights,
    assign,
    places_of,
    reacquire,
)
from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.joining import offset_in
from mvuav_ros.vision.markers.prediction import MotionPredictor
from mvuav_ros.vision.markers.view_filter import ViewFilter

FORGOTTEN = 10
"""Frames unseen after which a light's own motion tells nothing any more."""
KNOWN_PLACE = 5.0
"""px (1 sigma): where a marker's place is known better, even a clutter may be it."""
_PLACE_ERROR = (1.0, 0.005)
"""px, and units of the body's size: of any expected place (1 sigma)."""


class Search:
    """Names the lights of a frame by the body's geometry, some markers being known already.

    Attributes:
        found: the markers named, by their place in the rig.
    """

    def __init__(
        self,
        view_filter: ViewFilter,
        time: float,
        looks: Sequence[AppearanceModel],
        motion: MotionPredictor,
        predicted: Sequence[float],
        unseen: Sequence[int],
        found: dict[int, Detection],
    ) -> None:
        """Prepare for a frame.

        Args:
            view_filter: of an earlier frame; is carried on to this one.
            time: of the frame, s.
            looks: of every marker.
            motion: of every marker.
            predicted: by their motion, x and y of every marker in turn, px.
            unseen: frames since each marker was seen; 0 where its motion is known.
            found: the markers known already; is added to.
        """
        self.found = found
        self._view_filter = view_filter
        self._elapsed = time - view_filter.time
        self._looks = looks
        self._motion = motion
        self._predicted = predicted
        self._unseen = unseen
        self._prior = view_filter.advance(time)
        self._view = self._prior
        self._look()

    @property
    def missing(self) -> list[int]:
        """The markers without a spot."""
        return [index for index in range(len(self._looks)) if index not in self.found]

    def name(self, lights: Lights, clutter: Clutter) -> None:
        """Give names to the lights of the frame."""
        free = [
            spot
            for spot in lights.spots
            if not any(are_close(spot, known, known.radius) for known in self.found.values())
        ]
        self._name_clear(free, clutter)
        self._name_joined(free, lights)
        if not self.found:
            new = [spot for spot in free if not clutter.include(spot)]
            self.found.update(reacquire(self._view_filter, self._prior, new, self._is_likely))
            self._look()
        named = list(self.found.values())
        clutter.update([spot for spot in free if spot not in named])

    def finish(self) -> dict[int, Expectation]:
        """Keep the view of this frame.

        Returns:
            Where the markers should be that were not found.
        """
        # From one marker alone nobody can tell a turn.
        elapsed = self._elapsed if len(self.found) > 1 else 0.0
        self._view_filter.settle(self._prior, self._view, elapsed)
        return self._expectations()

    def _look(self) -> None:
        self._view = self._view_filter.look(self._prior, places_of(self.found))

    def _expectations(self) -> dict[int, Expectation]:
        """By the view of the markers found so far, or by their own motion."""
        shape = self._view_filter.shape
        places = self._view.places(shape)
        deviations = self._view.deviations(shape)
        return {
            index: self._expect(
                index, float(places[index, 0]), float(places[index, 1]), float(deviations[index])
            )
            for index in self.missing
        }

    def _expect(self, index: int, x: float, y: float, by_view: float) -> Expectation:
        # The others tell how the camera shakes; a marker's own motion does not, when it is old.
        unseen = self._unseen[index]
        if unseen == 0 or (by_view > KNOWN_PLACE and unseen < FORGOTTEN):
            by_motion = self._motion.deviation(index)
            moved_x, moved_y = self._predicted[2 * index], self._predicted[2 * index + 1]
            apart = math.hypot(moved_x - x, moved_y - y)
            if by_motion < by_view and apart < 3.0 * math.hypot(by_motion, by_view):
                return Expectation(moved_x, moved_y, by_motion)
        return Expectation(x, y, by_view)

    def _name_clear(self, free: list[Detection], clutter: Clutter) -> None:
        """Name what is clear: each name makes the view, and so the rest, clearer."""
        while free and (expected := self._expectations()):
            least = _PLACE_ERROR[0] + _PLACE_ERROR[1] * self._view.scale
            gates = {
                index: Expectation(e.x, e.y, math.hypot(e.deviation, least))
                for index, e in expected.items()
            }

            def fits(index: int, spot: Detection, gates: dict[int, Expectation] = gates) -> bool:
                if gates[index].deviation > KNOWN_PLACE and clutter.include(spot):
                    return False
                return self._is_likely(index, spot) and not self._is_joined(index, spot, gates)

            named = assign(gates, free, fits)
            if not named:
                return
            self.found.update(named)
            taken = list(named.values())
            free[:] = [spot for spot in free if spot not in taken]
            self._look()

    def _name_joined(self, free: list[Detection], lights: Lights) -> None:
        """Name two markers whose lights have run together."""
        if len(self.missing) < 2 or not free:
            return
        expected = self._expectations()
        for a, b in combinations(expected, 2):
            if a in self.found or b in self.found:
                continue
            if max(expected[a].deviation, expected[b].deviation) > KNOWN_PLACE:
                continue
            areas = self._looks[a].area, self._looks[b].area
            both = sum(areas)
            joined = [
                (spot, offset)
                for spot in free
                if 1.2 * max(areas) < spot.area < 1.3 * both
                and (offset := self._offset_in(spot, areas, a, b, expected)) is not None
            ]
            if len(joined) == 1:
                spot, offset = joined[0]
                free.remove(spot)
                variance = 0.125 * both / math.pi
                self.found[a], self.found[b] = lights.split(spot, *offset, variance)
                self._look()

    def _offset_in(
        self,
        spot: Detection,
        areas: tuple[float, float],
        a: int,
        b: int,
        expected: Mapping[int, Expectation],
    ) -> tuple[float, float] | None:
        """From one marker to the other in a spot that may be both, px."""
        pair = expected[a], expected[b]
        variances = np.array([place.deviation**2 for place in pair])
        places = np.array([(place.x, place.y) for place in pair])
        offset = offset_in(spot, areas, places, np.diag(np.repeat(variances, 2)))
        shape = self._view_filter.shape
        by_view = self._view.deviations(shape)[[a, b]]
        if offset is None and len(self.found) >= 2 and by_view.max() <= KNOWN_PLACE:
            # Not as they moved, or their motions do not tell the sides; the others' places may.
            jacobian = self._view.jacobian(shape)[[a, b]].reshape(4, 7)
            spread = jacobian @ self._view.covariance @ jacobian.T
            offset = offset_in(spot, areas, self._view.places(shape)[[a, b]], spread)
        if offset is None or math.hypot(*offset) > _touching(*areas):
            return None
        return float(offset[0]), float(offset[1])

    def _is_likely(self, index: int, spot: Detection) -> bool:
        return self._looks[index].is_likely(spot)

    def _is_joined(self, index: int, spot: Detection, gates: dict[int, Expectation]) -> bool:
        """Whether the spot is probably this marker and another missing one together."""
        if not self._looks[index].may_be_joined(spot):
            return False
        return any(
            math.hypot(spot.x - place.x, spot.y - place.y)
            < spot.radius + self._looks[other].radius + 3.0
            for other, place in gates.items()
            if other != index
        )


def _touching(first: float, second: float) -> float:
    """The distance of two centres, px, up to which lights of such areas (px) may run together."""
    return math.sqrt(first / math.pi) + math.sqrt(second / math.pi) + 3.0


def are_close(a: Detection, b: Detection, distance: float) -> bool:
    """Whether two spots lie less than a distance (px) apart."""
    return (a.x - b.x) ** 2 + (a.y - b.y) ** 2 < distance * distance

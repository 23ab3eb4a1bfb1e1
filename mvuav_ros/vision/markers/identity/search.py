"""One frame in which not all markers are where and as they should be."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from itertools import combinations

import numpy as np

from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.identity.appearance import AppearanceModel, is_joined, offset_in
from mvuav_ros.vision.markers.identity.assignment import GATE, Expectation, assign
from mvuav_ros.vision.markers.identity.clutter import Clutter, Rejections
from mvuav_ros.vision.markers.identity.fault_detection import TUNING as FAULTS
from mvuav_ros.vision.markers.identity.fault_detection import Consensus, FaultDetector
from mvuav_ros.vision.markers.identity.initialization import Named
from mvuav_ros.vision.markers.identity.marker_memory import KNOWN_PLACE, Motion
from mvuav_ros.vision.markers.identity.reacquisition import Recovery, extend, reacquire
from mvuav_ros.vision.markers.lights import Lights, are_close, places_of
from mvuav_ros.vision.markers.rig_view import COUNT, ViewState

CERTAIN = 15.0
"""px (1 sigma): where every marker's place is known better, what lies far from all is clutter."""
GATE_OF_FEW = 6.0
"""Squared distance over variance at which a light is too far where later frames could not tell."""
BESIDE = 24.0
"""px within which another light may be taken for a marker that is not where it was expected."""
MOST_RETURNED = 10  # Lights among which a body that was out of sight is looked for


class Search:
    """Names the lights of a frame by the body's geometry, some markers being known already."""

    def __init__(
        self,
        faults: FaultDetector,
        looks: Sequence[AppearanceModel],
        motion: Motion,
        consensus: Consensus,
        found: Mapping[int, Detection],
        rejections: Rejections,
    ) -> None:
        """Begin with the markers found so far; those that a consensus drops are rejected."""
        self._rejections = rejections
        for marker in consensus.dropped:
            rejections.add(marker, found[marker])
        # The markers named, by their place in the rig, px without distortion.
        self.found = {index: found[index] for index in (*consensus.kept, *consensus.suspects)}
        self._known = tuple(self.found)
        self.faults = faults  # what speaks against each marker
        self.views = faults.views  # at this frame's time
        # Those of the found of which one or some must be another light.
        self.suspects = set(consensus.suspects)
        # Markers found again together, after hardly any was in sight.
        self.reacquired: set[int] = set()
        self.alone: set[int] = set()  # markers beside whose lights no other light is near
        self.unexplained = 0  # lights that may be markers and have no name
        # Whether lights without a name cannot be markers that return: false where it is only not
        # clear which they are.
        self.is_contradicted = True
        self._looks = looks
        self._motion = motion
        self._distrusted = set(consensus.dropped)
        self._view = consensus.view
        self._was_certain = float(self.views.places()[1].max()) < CERTAIN

    @property
    def missing(self) -> list[int]:
        """The markers without a spot."""
        return [index for index in range(len(self._looks)) if index not in self.found]

    def name(self, lights: Lights, clutter: Clutter, fewest: int, recovery: Recovery) -> int:
        """Give names to the lights of the frame; how many lights have none.

        A body that is out of sight is found again by the fewest markers or more.
        """
        self._clutter = clutter
        self._free = [
            spot
            for spot in lights.spots
            if not any(are_close(spot, known, known.radius) for known in self.found.values())
        ]
        if self._rejections:
            self._rejections.follow(list(lights.spots), self._expectations(self.missing))
        if not self.suspects:
            self._name_clear()
            self._name_joined(lights)
            if len(self.found) >= 2:
                self._name_together()
        if len(self.found) < 2:
            self._find_again(fewest)
        elif not self.suspects and len(self.missing) >= 2:
            self._recover(recovery)
        self._check()
        self._forget_lone()
        self.alone = {
            marker
            for marker, own in self.found.items()
            if sum(are_close(own, spot, BESIDE) for spot in lights.spots) <= 1
        }
        named = list(self.found.values())
        nameless = [spot for spot in self._free if spot not in named]
        known = len(self.found) >= min(3, len(self._looks)) or self._was_certain
        clutter.update(nameless, self._expectations(self.missing) if known else None)
        self.unexplained = sum(not clutter.include(spot) for spot in nameless)
        return len(nameless)

    def _take(self, found: dict[int, Detection]) -> None:
        """Take names; what is clear by now gets one as well."""
        self.found = found
        self._look()
        named = list(found.values())
        self._free = [spot for spot in self._free if spot not in named]
        self._name_clear()

    def _name_clear(self) -> None:
        """Name what is clear: each name makes the view, and so the rest, clearer."""
        while self._free and (expected := self._expectations(self.missing)):
            least = self.views.deviation
            gates = {
                index: Expectation(e.x, e.y, math.hypot(e.deviation, least))
                for index, e in expected.items()
            }

            def fits(index: int, spot: Detection, gates: dict[int, Expectation] = gates) -> bool:
                if gates[index].deviation > KNOWN_PLACE and self._clutter.include(spot):
                    return False
                return self._is_likely(index, spot) and not is_joined(
                    index, spot, self._looks, gates
                )

            named = assign(gates, self._free, fits)
            if not named:
                return
            self.found.update(named)
            taken = list(named.values())
            self._free = [spot for spot in self._free if spot not in taken]
            self._look()

    def _name_joined(self, lights: Lights) -> None:
        """Name two markers whose lights have run together."""
        if len(self.missing) < 2 or not self._free:
            return
        expected = self._expectations(self.missing)
        for a, b in combinations(expected, 2):
            if a in self.found or b in self.found:
                continue
            if max(expected[a].deviation, expected[b].deviation) > KNOWN_PLACE:
                continue
            areas = self._looks[a].area, self._looks[b].area
            both = sum(areas)
            joined = [
                (spot, offset)
                for spot in self._free
                if 1.2 * max(areas) < spot.area < 1.3 * both
                and (offset := self._offset_in(spot, areas, expected, [a, b])) is not None
            ]
            if len(joined) == 1:
                spot, offset = joined[0]
                self._free.remove(spot)
                variance = 0.125 * both / math.pi
                self.found[a], self.found[b] = lights.split(spot, *offset, variance)
                self._look()

    def _offset_in(
        self,
        spot: Detection,
        areas: tuple[float, float],
        expected: Mapping[int, Expectation],
        pair: list[int],
    ) -> tuple[float, float] | None:
        """From one marker to the other in a spot that may be both, px."""
        first, second = (expected[marker] for marker in pair)
        places = np.array((first.x, first.y, second.x, second.y))
        spread = np.diag(np.repeat((first.deviation**2, second.deviation**2), 2))
        offset = offset_in(spot, areas, places, spread)
        by_view = self.views.places(self._view)[1][pair]
        if offset is None and len(self.found) >= 2 and by_view.max() <= KNOWN_PLACE:
            # Not as they moved, or their motions do not tell the sides; the others' places may.
            seen, jacobian = self.views.shape.linearize(self._view.parameters)
            slopes = jacobian[pair].reshape(4, COUNT)
            spread = slopes @ self._view.covariance @ slopes.T
            offset = offset_in(spot, areas, seen[pair].ravel(), spread)
        touching = sum(math.sqrt(area / math.pi) for area in areas) + 3.0
        return None if offset is None or math.hypot(*offset) > touching else offset

    def _name_together(self) -> None:
        """Name lights where the markers in sight hardly tell where the others are."""
        expected = self._expectations(self.missing).values()
        new = [spot for spot in self._free if not self._clutter.include(spot)]
        if new and any(place.deviation > KNOWN_PLACE for place in expected):
            self._take({**self.found, **extend(self.views, self.found, new, self._is_likely)})

    def _recover(self, recovery: Recovery) -> None:
        """Name lights that are not where they were expected, as the rig alone tells."""
        new = [spot for spot in self._free if not self._clutter.is_stranger(spot)]
        # Lights that fit the rig together are its markers, whatever was thought of one of them.
        found = recovery.name(self.views, self.found, new, lambda m, s: self._looks[m].is_likely(s))
        if len(found) > len(self.found):
            self._known = tuple(found)
            self._take(found)

    def _find_again(self, fewest: int) -> None:
        """Name a body of which at most one marker is where it was expected."""
        spots = [*self.found.values(), *self._free]
        new = [spot for spot in spots if not self._clutter.include(spot)][:MOST_RETURNED]
        fewest = max(fewest, 3) if self.found else fewest
        ways = reacquire(self.views, new, self._is_likely, fewest)
        self.is_contradicted = ways is None
        if ways:
            self.suspects.clear()
            self.reacquired = set(ways)
            self._free = spots
            self._take(ways)

    def _check(self) -> None:
        """Take back names that the others contradict, those given in this frame first."""
        newcomers = [marker for marker in self.found if marker not in self._known]
        while newcomers and len(self._known) >= 2:
            surprise = self.faults.surprise_of(places_of(self.found))
            few = len(self.found) < FAULTS.fewest_agreeing < len(self._looks)
            if max(surprise.values()) <= (GATE_OF_FEW if few else GATE):
                break
            worst = max(newcomers, key=lambda marker: surprise[marker])
            newcomers.remove(worst)
            self._distrusted.add(worst)
            del self.found[worst]
        consensus = self.faults.weigh(places_of(self.found))
        for marker in consensus.dropped:
            self._distrusted.add(marker)
            del self.found[marker]
        self.suspects = set(consensus.suspects)
        self._view = consensus.view
        if self.suspects and not consensus.kept:
            self.faults.upset()

    def _forget_lone(self) -> None:
        """Take back a frame's one name if it is new and its place was hardly known."""
        if len(self.found) == 1 and not self._known:
            (place,) = self._expectations(self.found, self.views.view).values()
            if place.deviation > KNOWN_PLACE:
                self.found.clear()

    def replace(self, faults: FaultDetector, named: Named) -> None:
        """Take the names of a body that was named afresh."""
        self.faults, self.views, self._view = faults, faults.views, faults.views.view
        self.found = dict(enumerate(named.spots))
        self.suspects = set()

    def finish(self) -> dict[int, Expectation]:
        """Keep the view of this frame; where markers not found should be, px without distortion."""
        expected = self._expectations(self.missing)
        self.faults.commit(places_of(self.found))
        return expected

    def _look(self) -> None:
        self._view = self.views.look(places_of(self.found))

    def _expectations(
        self, markers: Collection[int], view: ViewState | None = None
    ) -> dict[int, Expectation]:
        """Where markers should be by the view of those found so far, or by their own motion."""
        places, deviations = self.views.places(view or self._view)
        x, y = places.T.tolist()
        by_view = deviations.tolist()
        expected = {i: Expectation(x[i], y[i], by_view[i]) for i in markers}
        return {
            i: place if i in self._distrusted else self._motion.refine(i, place)
            for i, place in expected.items()
        }

    def _is_likely(self, index: int, spot: Detection) -> bool:
        return self._looks[index].is_likely(spot) and not self._rejections.concern(index, spot)

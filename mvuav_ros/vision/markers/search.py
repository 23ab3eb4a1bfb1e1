"""One frame in which not all markers are where and as they should be."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from itertools import combinations

import numpy as np

from mvuav_ros.vision.markers.assignment import (
    GATE,
    Expectation,
    Recovery,
    assign,
    extend,
    reacquire,
)
from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.fault_detection import TUNING as FAULTS
from mvuav_ros.vision.markers.fault_detection import Consensus, FaultDetector
from mvuav_ros.vision.markers.initialization import Named
from mvuav_ros.vision.markers.lights import Lights, are_close, places_of
from mvuav_ros.vision.markers.marker_memory import (
    KNOWN_PLACE,
    AppearanceModel,
    Motion,
    offset_in,
)
from mvuav_ros.vision.markers.rig_view import COUNT, ViewState

STRANGE = 3  # Frames without a name after which a light is clutter
REMEMBERED = 150  # Frames for which lights may be clutter after one has been seen
CLUTTER_STEP = 8.0  # px that clutter may move in a frame, as the camera shakes
REJECTED_FOR = 45  # Frames for which a light is not taken again for the marker that it was not
STEP = 10.0  # px that it may move in a frame
RELEASED = 2.0
"""Deviations within which it lies where the others put the marker: then it is the marker."""
SURE = 5.0  # px (1 sigma): how well that place must be known


class Clutter:
    """Lights that have stayed without a name for some frames: glares, not returning markers."""

    def __init__(self) -> None:
        self._seen: list[tuple[float, float, int]] = []
        self._places: list[tuple[float, float]] = []
        self._frames_without = REMEMBERED

    @property
    def is_about(self) -> bool:
        """Whether there was any within the last seconds."""
        return self._frames_without < REMEMBERED

    def include(self, spot: Detection) -> bool:
        """Whether a light has stood there, or close by, for long."""
        return any(age >= STRANGE and _is_beside(spot, x, y) for x, y, age in self._seen)

    def is_clutter(self, spot: Detection) -> bool:
        """Whether a light was there already while all markers were elsewhere."""
        return any(_is_beside(spot, x, y) for x, y in self._places)

    def update(
        self, spots: Sequence[Detection], expected: Mapping[int, Expectation] | None
    ) -> None:
        """Take the lights of a frame that got no name.

        What lies far from all places where markers without a light are expected is none. Where the
        body is out of sight (None), only what was clutter before is followed.
        """
        seen = []
        for spot in spots:
            ages = [age for x, y, age in self._seen if _is_beside(spot, x, y)]
            if expected is not None:
                near = any(_may_be_at(spot, place) for place in expected.values())
                ages.append(0 if near else max(ages, default=0) + STRANGE)
            if ages:
                seen.append((spot.x, spot.y, max(ages)))
        self._places = [
            (spot.x, spot.y) for spot in spots if expected == {} or self.is_clutter(spot)
        ]
        self._seen = seen
        strange = any(age >= STRANGE for *_, age in seen)
        self._frames_without = 0 if strange else self._frames_without + 1


class Rejections:
    """For each marker the light that others contradicted, followed by its place.

    Without this the light would get the name back in the next frame, as it is still near.
    """

    def __init__(self) -> None:
        self._lights: dict[int, tuple[Detection, int]] = {}

    def __bool__(self) -> bool:
        """Whether any light is remembered."""
        return bool(self._lights)

    def add(self, marker: int, light: Detection) -> None:
        """This light is not that marker."""
        self._lights[marker] = light, REJECTED_FOR

    def clear(self) -> None:
        """All names are new."""
        self._lights.clear()

    def concern(self, marker: int, light: Detection) -> bool:
        """Whether this is the light that was not that marker."""
        return marker in self._lights and _apart(self._lights[marker][0], light) < STEP

    def follow(self, lights: list[Detection], expected: Mapping[int, Expectation]) -> None:
        """Go on to the next frame's lights; expected are the markers without one (px, ideal)."""
        kept: dict[int, tuple[Detection, int]] = {}
        for marker, (light, left) in self._lights.items():
            near = min(lights, key=lambda other: _apart(light, other), default=light)
            near = near if _apart(light, near) < STEP else light
            place = expected.get(marker)
            if place is not None and place.deviation < SURE:
                away = math.hypot(near.x - place.x, near.y - place.y)
                if away < RELEASED * place.deviation:
                    continue
            if left > 1 and place is not None:
                kept[marker] = near, left - 1
        self._lights = kept


def _is_beside(spot: Detection, x: float, y: float) -> bool:
    return abs(x - spot.x) < CLUTTER_STEP and abs(y - spot.y) < CLUTTER_STEP


def _may_be_at(spot: Detection, place: Expectation) -> bool:
    reach = CLUTTER_STEP + 4.0 * place.deviation
    return math.hypot(spot.x - place.x, spot.y - place.y) < reach


def _apart(a: Detection, b: Detection) -> float:
    return math.hypot(a.x - b.x, a.y - b.y)


CERTAIN = 15.0
"""px (1 sigma): where every marker's place is known better, what lies far from all is clutter."""
GATE_OF_FEW = 6.0
"""Squared distance over variance at which a light is too far where later frames cannot help."""
BESIDE = 24.0
"""px within which another light may be taken for a marker that is not where it was expected."""
MAX_RETURNED = 10  # Lights among which a body that was out of sight is looked for


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
                return self._is_likely(index, spot)

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
            # Not as they moved, or their motions do not show the sides; the others' places may.
            seen, jacobian = self.views.shape.linearize(self._view.parameters)
            slopes = jacobian[pair].reshape(4, COUNT)
            spread = slopes @ self._view.covariance @ slopes.T
            offset = offset_in(spot, areas, seen[pair].ravel(), spread)
        touching = sum(math.sqrt(area / math.pi) for area in areas) + 3.0
        return None if offset is None or math.hypot(*offset) > touching else offset

    def _name_together(self) -> None:
        """Name lights where the markers in sight hardly determine where the others are."""
        expected = self._expectations(self.missing).values()
        new = [spot for spot in self._free if not self._clutter.include(spot)]
        if new and any(place.deviation > KNOWN_PLACE for place in expected):
            self._take({**self.found, **extend(self.views, self.found, new, self._is_likely)})

    def _recover(self, recovery: Recovery) -> None:
        """Name lights that are not where they were expected, as the rig alone determines."""
        new = [spot for spot in self._free if not self._clutter.is_clutter(spot)]
        # Lights that fit the rig together are its markers, whatever was thought of one of them.
        found = recovery.name(self.views, self.found, new, lambda m, s: self._looks[m].is_likely(s))
        if len(found) > len(self.found):
            self._known = tuple(found)
            self._take(found)

    def _find_again(self, fewest: int) -> None:
        """Name a body of which at most one marker is where it was expected."""
        spots = [*self.found.values(), *self._free]
        new = [spot for spot in spots if not self._clutter.include(spot)][:MAX_RETURNED]
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
            nis = self.faults.nis_of(places_of(self.found))
            few = len(self.found) < FAULTS.min_agreeing < len(self._looks)
            if max(nis.values()) <= (GATE_OF_FEW if few else GATE):
                break
            worst = max(newcomers, key=lambda marker: nis[marker])
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
            self.faults.inflate()

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

    def finish(self) -> tuple[dict[int, Expectation], dict[int, float]]:
        """Keep the view of this frame.

        Returns:
            Where markers not found should be, px without distortion; and for those found what their
            places say for their names (see `Correction.log_odds`).
        """
        expected = self._expectations(self.missing)
        return expected, self.faults.commit(places_of(self.found))

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

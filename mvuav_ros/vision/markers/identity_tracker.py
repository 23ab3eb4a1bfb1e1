"""A body's markers followed under their names, whatever hides, joins or imitates them."""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.fault_detection import MIN_AGREEING, FaultDetector
from mvuav_ros.vision.markers.initialization import Attempts, Trial, fewest_at_start, initialize
from mvuav_ros.vision.markers.lamps import Lamps
from mvuav_ros.vision.markers.lights import (
    Detection,
    Frame,
    Lens,
    Light,
    Point,
    apart_from,
    coordinates,
    places_of,
)
from mvuav_ros.vision.markers.marker_memory import Expectation, MarkerMemory
from mvuav_ros.vision.markers.marker_results import (
    WINGS,
    Marker,
    MarkerResult,
    MarkerState,
    Window,
    all_lost,
    counts_of,
    labels_of,
    roll_of,
)
from mvuav_ros.vision.markers.naming import Clutter, Search
from mvuav_ros.vision.markers.rig_view import WeakPerspective
from mvuav_ros.vision.markers.view_filter import ViewFilter
from mvuav_ros.vision.rig import MAX_NAMED, MarkerRig

GIVEN_UP = 10.0  # Seconds without a reported name after which nothing is known of the body any more
LOOKS = 60, 3
"""Frames in one of which all lights are looked at for lamps; the same while one may yet be one."""
WIDEST = 200.0  # px, by which a search window grows at most


class IdentityTracker:
    """The whole frame at the start, then a window for each marker; the whole frame in doubt.

    The markers in sight determine how the rig is seen (see `ViewFilter`), and a marker that the
    others contradict loses its name (see `FaultDetector`). Usually all are alone in their windows,
    look as before, and agree. If any does not, the bright pieces of the whole frame are named
    by the body's geometry (see `Search`): a piece gets a name only where no other fits.
    """

    def __init__(
        self,
        rig: MarkerRig,
        camera: CameraModel | None = None,
        lamps: Lamps | None = None,
        upright: float = 0.0,
    ) -> None:
        """Prepare for the first frame; a level body has the roll ``upright`` (rad)."""
        self._rig, self._camera, self._upright = rig, camera, upright
        self.lamps = lamps or Lamps()  # of the body, which are known longer than it is followed
        self._count = len(rig.names)
        self._labels = labels_of(rig.names)
        self._wings = [rig.names.index(wing) for wing in WINGS if wing in rig.names]
        self._size = (0, 0)
        self._tick = self._next_look = 0
        self.lights = 0  # in the newest frame in which the whole body was looked for
        self._start_again()

    def _start_again(self, was_wrong: bool = False) -> None:
        """Know nothing of the body, but that one was followed that was none, if so."""
        self._body: tuple[FaultDetector, MarkerMemory] | None = None
        self._clutter = Clutter()
        self._attempts = Attempts(was_wrong)
        self._trial: Trial | None = None  # of a body that is not what its rig says

    def track(self, image: Image, time: float, parameters: MarkerTrackerParameters) -> MarkerResult:
        """Find the body's markers in the next frame, of a later time (s) than the last one."""
        self._tick += 1
        size = image.width, image.height
        if size != self._size:
            self._size, self._lens = size, Lens(size, self._camera)
            self._shape = WeakPerspective.of(self._rig, self._lens, self._upright)
            # Any three lights look like three markers, and any four where the lens is not known.
            self._is_redundant = self._count > (3 if self._lens.focal else 4)
            self._start_again()
        frame = Frame(image, time, self._tick, parameters, self._lens)
        result = self._follow(frame, *self._body) if self._body else self._start(frame)
        return result if result.named else result.remarked(frame.blobs.crowd)

    def _start(self, frame: Frame, lamps: Collection[Light] = ()) -> MarkerResult:
        """Name all markers in a whole frame, in which some lights are known to be lamps."""
        self.lights = seen = len(frame.blobs.may_be_lights()) - len(lamps)
        if not self._attempts.due(seen):
            return self._nothing(f'{seen} lights in view, {self._count} do not stand out')
        if seen < fewest_at_start(self._shape):
            return self._nothing(f'{seen} of {self._count} markers in view')
        lights = [light for light in frame.lights() if light not in lamps]
        named = initialize(self._shape, lights, self._rig.names, self._attempts.failed)
        if named.view is None:
            self._attempts.fail()
            return self._nothing(named.remark)
        if not self._attempts.succeed(named):
            # Another way of naming the same lights than a frame ago: neither can be believed.
            return self._nothing('the markers were named in two ways')
        if not self._attempts.confirmed(named, self._lens.focal is not None):
            return self._nothing(f'{seen} lights in view, not yet certain')
        self._start_again(self._attempts.was_wrong)
        memory = MarkerMemory(frame.time, named.lights, self._count, self._is_redundant)
        shape, places = self._shape, places_of(named.lights)
        if not named.fits:
            self._trial = Trial(shape, named.view, places)
            shape = shape.with_offsets(named.view, np.array(list(places.values())))
        self._body = FaultDetector(ViewFilter(shape, named.view, frame.time)), memory
        self._is_sure = True  # whether four firm names agreed in the newest frame
        self._last_named = frame.time  # of the last frame with a name
        spots = {index: light.seen for index, light in named.lights.items()}
        return self._result(frame, memory, spots, remark=named.remark)

    def _follow(self, frame: Frame, faults: FaultDetector, memory: MarkerMemory) -> MarkerResult:
        memory.predict(frame.time)
        faults.views.predict(frame.time)
        spots, windows = memory.look(frame)
        named = dict(zip(spots, self._lens.straightened(spots.values()), strict=True))
        faults.jumps = memory.jumps.evidence
        faults.untrusted = memory.untrusted
        faults.doubtful = memory.doubtful
        consensus = faults.weigh(named)
        if len(consensus.kept) == self._count:
            return self._go_on(frame, spots, named, windows)
        for marker in consensus.dropped:
            memory.predictor.forget(marker)
        doubted = memory.distrust(spots)
        faults.untrusted = memory.untrusted
        found = {index: Light(*place, spots[index]) for index, place in named.items()}
        search = Search(faults, memory.markers, consensus, found)
        self._search(frame, search, 0.0 if self._is_lost(frame) else memory.least_area)
        if search.faults is not faults:
            self._body = search.faults, memory
            memory.start_afresh()
        if self._is_lost(frame):
            # A body wholly in view may be far from where it was lost.
            if frame.time - self._last_named > GIVEN_UP and not search.lamps:
                self._start_again()
            started = self._start(frame, search.lamps)
            if started.named or self._body is None:
                return started
        if self._trial is not None:
            agreeing = {m: light for m, light in search.found.items() if m not in search.suspects}
            contradicted = bool(consensus.dropped or consensus.suspects)
            if self._trial.is_refuted(places_of(agreeing), contradicted):
                return self._give_up()
        memory.trust_again(doubted, search.alone)
        if self._tick >= self._next_look:
            search.learn_lamps()
            self._wait_for_lamps()
        return self._conclude(frame, memory, search, windows)

    def _go_on(
        self,
        frame: Frame,
        spots: Mapping[int, Detection],
        named: Mapping[int, Point],
        windows: Sequence[Window],
    ) -> MarkerResult:
        """The usual frame: all markers are in their windows (px of the image), and agree."""
        assert self._body is not None
        faults, memory = self._body
        if self._trial is not None and self._trial.is_refuted(named):
            return self._give_up()
        memory.weigh(spots, faults.evidence(named))
        faults.commit(named)
        self._is_sure = True
        memory.remember(frame.time, spots, {})
        if self._tick >= self._next_look:
            own = [Light(*place, spots[marker]) for marker, place in named.items()]
            others, places, views = apart_from(frame.lights(), own), coordinates(own), faults.views
            self.lamps.learn(views.shape, views.view, others, places, is_whole=True)
            self._wait_for_lamps()
        return self._result(frame, memory, spots, windows=windows)

    def _wait_for_lamps(self) -> None:
        """They have been looked at: not in the next frames again."""
        self._next_look = self._tick + LOOKS[self.lamps.is_learning]

    def _give_up(self) -> MarkerResult:
        self._start_again(was_wrong=True)
        return self._nothing('the lights are not those of one body')

    def _conclude(
        self, frame: Frame, memory: MarkerMemory, search: Search, windows: list[Window]
    ) -> MarkerResult:
        """Remember and report what a search has found."""
        # Where other lights are about, some three of all nearly always look like three markers.
        if not self._clutter.is_about:
            memory.trust(search.reacquired)
        expected = search.expected(search.missing)
        seen = self._lens.to_image(np.array([place[:2] for place in expected.values()])).tolist()
        expected = {
            index: place._replace(x=x, y=y)
            for (index, place), (x, y) in zip(expected.items(), seen, strict=True)
        }
        others = self._clutter.is_about or not self._is_redundant
        faults, places = search.faults, places_of(search.found)
        landmarks = search.landmarks
        evidence = faults.evidence(places, landmarks)
        memory.weigh(search.found, evidence, search.given, others, search.reacquired, landmarks)
        faults.doubtful = memory.doubtful
        faults.commit(places)
        if len(search.found.keys() - search.suspects - memory.doubtful) >= MIN_AGREEING:
            self._is_sure = True
        for index, (x, y, deviation) in expected.items():
            radius = frame.parameters.search_radius + math.ceil(min(3.0 * deviation, WIDEST))
            windows[index] = Window.around(x, y, radius, self._size)
        spots = {index: light.seen for index, light in search.found.items()}
        memory.remember(frame.time, spots, expected)
        hidden = search.suspects | memory.doubtful
        return self._result(frame, memory, spots, hidden, expected, windows)

    def _search(self, frame: Frame, search: Search, least: float) -> None:
        """Name the lights of the whole frame, of an area (px) at least (see `Frame.lights`)."""
        # The filter as it was when four firm names agreed last; since then it has gone on alone.
        if self._is_sure:
            self._sure, self._is_sure = copy.copy(search.views), False
        else:
            self._sure.predict(frame.time)
        lights = frame.lights(least)
        # Among many lights either this or a new start takes long enough for one frame.
        rests = self._attempts.rest or self._attempts.last
        if rests or len(lights) <= MAX_NAMED or not self._is_lost(frame):
            search.name(lights, self._clutter, self.lamps, self._sure)

    def _is_lost(self, frame: Frame) -> bool:
        """Whether no name has been reported for so long that the body is looked for anew."""
        return frame.time - self._last_named > frame.parameters.lost_timeout

    def _nothing(self, status: str) -> MarkerResult:
        return all_lost(self._rig.names, status)

    def _result(
        self,
        frame: Frame,
        memory: MarkerMemory,
        spots: Mapping[int, Detection],
        hidden: Collection[int] = (),
        expected: Mapping[int, Expectation] = {},
        windows: Sequence[Window] = (),
        remark: str = '',
    ) -> MarkerResult:
        """What is reported of a frame; hidden and missing markers are where expected, px."""
        if spots.keys() - hidden:
            self._last_named = frame.time
        if not self._is_redundant:
            hidden = {*hidden, *memory.untrusted}
        if hidden:
            spots = {index: spot for index, spot in spots.items() if index not in hidden}
        earliest = frame.time - frame.parameters.lost_timeout
        rows = zip(self._labels, memory.predictor.motions(), memory.markers, strict=True)
        markers, detected = [], MarkerState.DETECTED
        for index, (label, motion, known) in enumerate(rows):
            if index in spots:
                x, y, area, _ = spots[index]
                markers.append(Marker(label, detected, x, y, *motion, area, known.confidence))
            elif known.last_seen >= earliest and index in expected:
                x, y, _ = expected[index]
                markers.append(Marker(label, MarkerState.PREDICTED, x, y, *motion))
            else:
                markers.append(Marker(label, MarkerState.LOST))
        has_wings = len(self._wings) == 2
        roll = roll_of(*(markers[wing] for wing in self._wings)) if has_wings else math.nan
        status = remark
        if len(spots) < len(markers):
            status = counts_of(markers) + (f' ({remark})' if remark else '')
        places = tuple(memory.predicted) if windows else ()
        return MarkerResult(tuple(markers), roll, status, tuple(windows), places, has_wings)

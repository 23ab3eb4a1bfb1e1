"""A body's markers followed under their names, whatever hides, joins or imitates them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.camera import CalibrationError, CameraModel
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.acquisition import ANY_ROLL
from mvuav_ros.vision.markers.appearance import AppearanceModel
from mvuav_ros.vision.markers.assignment import (
    NEARBY_ROLL,
    Clutter,
    Expectation,
    Lights,
    Named,
    initialize,
    places_of,
    straightened,
)
from mvuav_ros.vision.markers.attempts import Attempts
from mvuav_ros.vision.markers.blobs import Blobs
from mvuav_ros.vision.markers.centroid import CentroidMeter, Cut, Detection, cutter
from mvuav_ros.vision.markers.grouping import GroupingError
from mvuav_ros.vision.markers.prediction import MotionPredictor
from mvuav_ros.vision.markers.results import (
    NO_WINDOW,
    TANKER_LABELS,
    TANKER_NAMES,
    Marker,
    MarkerResult,
    MarkerState,
    Window,
)
from mvuav_ros.vision.markers.search import FORGOTTEN, Motion, Search, are_close
from mvuav_ros.vision.markers.view import ROLL, Lens, WeakPerspective, offsets_of
from mvuav_ros.vision.markers.view_filter import ViewFilter
from mvuav_ros.vision.rig import MarkerRig

EDGE = 4.0
"""px of dark that a window shows around a light."""
SAME_SPOT = 3.0
"""Two markers closer than this (px) are one light."""
RETURNING = 2
"""Frames after its return in which a marker is named by the geometry: its motion, by which its
window is placed, is not known yet."""
SURE_PLACE = 2.0
"""px (1 sigma): a place known this well stands in for a measurement."""
GIVEN_UP = 10.0
"""Seconds without any marker after which nothing is known of the body any more."""
WIDEST = 200.0
"""px, by which a search window grows at most."""
YOUNG = 1.0
"""s without any marker up to which two are enough to find the body again."""
PROBATION = 30
"""Frames after a marker was out of sight or not alone in which its light may be another one."""
CONFIRMED = 3
"""Frames in which a body must be named alike where one frame does not make it certain."""
PATIENCE = 5
"""Frames in doubt after which the whole body is named afresh, as at the start."""
EXACT = 4.0
"""Deviations of a marker from its rig's place (root mean square) at which a body that was known
before is another one."""
_FAR_OFF = 1e6

Detections = list[Detection | None]


@dataclass(frozen=True, eq=False)
class _Frame:
    """One image, and how its lights are measured."""

    image: Image
    time: float
    parameters: MarkerTrackerParameters
    meter: CentroidMeter
    cut: Cut

    def lights(self, lens: Lens, around: Sequence[float] = ()) -> Lights:
        """The lights of the whole frame.

        Args:
            lens: of the camera.
            around: x and y of places in turn, px: of very many lights the nearest to them are
                measured; the largest if there are none.

        Raises:
            GroupingError: it is too bright or too noisy to hold markers.
        """
        blobs = Blobs(self.image.gray(), self.parameters)
        return Lights(blobs, self.cut, self.meter, lens, around)


@dataclass
class _Known:
    """What is remembered of one marker."""

    look: AppearanceModel
    last_seen: float = -math.inf
    unseen: int = 0
    returning: int = RETURNING
    contested: int = 0


class IdentityTracker:
    """The whole frame at the start, then a window for each marker; the whole frame in doubt.

    Every frame is held against the rig: the markers in sight tell how it is seen (see
    `ViewFilter`), and a marker that the others contradict loses its name. Markers that are alone
    in their windows, as they usually look, and agree are taken (the fast way, and the usual one).
    If any is not, the bright pieces of the whole frame are named by the body's geometry (see
    `Search`): a piece gets a name only where no other fits. While doubts stay, the body is also
    named afresh, and if that contradicts the names frame after frame, it replaces them.
    """

    def __init__(self, rig: MarkerRig) -> None:
        self._rig = rig
        self._count = len(rig.names)
        self._labels: list[int] = list(range(self._count))
        if rig.names == TANKER_NAMES:
            self._labels = [*TANKER_LABELS]
        self._wings = _wings(rig)
        self._size = (0, 0)
        self._camera: CameraModel | None = None
        self._start_again()

    def set_camera(self, camera: CameraModel | None) -> None:
        """Take a calibration, or that there is none; what was known under another one is lost."""
        if camera != self._camera:
            self._camera = camera
            self._size = (0, 0)

    def _start_again(self) -> None:
        self._filter = MotionPredictor(self._count)
        self._views: ViewFilter | None = None
        self._clutter = Clutter()
        self._markers: list[_Known] = []
        self._attempts = Attempts(self._count)
        self._doubts = 0
        self._exact = True
        self._tick = 0

    def track(self, image: Image, time: float, parameters: MarkerTrackerParameters) -> MarkerResult:
        """Find the body's markers in the next frame.

        Args:
            image: the frame.
            time: its stamp, s, later than the last frame's.
            parameters: may change from frame to frame.
        """
        size = (image.width, image.height)
        if size != self._size:
            self._size = size
            self._lens = _lens_of(size, self._camera)
            self._shape = WeakPerspective.of(self._rig, self._lens)
            self._start_again()
        meter = CentroidMeter(parameters.threshold, parameters.weighted)
        frame = _Frame(image, time, parameters, meter, cutter(image))
        self._tick += 1
        if self._views is None:
            return self._start(frame)
        return self._follow(frame, self._views)

    def _start(self, frame: _Frame) -> MarkerResult:
        """Name all markers in a whole frame."""
        try:
            lights = frame.lights(self._lens)
        except GroupingError as error:
            self._attempts.fail()
            return self._nothing(str(error))
        if not self._attempts.due(len(lights)):
            return self._nothing(f'{len(lights)} lights in view, {self._count} do not stand out')
        if len(lights) < self._count:
            return self._nothing(f'{len(lights)} of {self._count} markers in view')
        named = initialize(self._shape, lights, self._rig.names)
        if named.view is None:
            self._attempts.fail()
            return self._nothing(named.remark)
        if not self._attempts.succeed(named):
            # Another way of naming the same lights than a frame ago: neither can be believed.
            return self._nothing('the markers were named in two ways')
        if not named.certain and self._attempts.agreed < CONFIRMED:
            return self._nothing(f'{len(lights)} lights in view, not yet certain')
        spots: Detections = [lights.in_image(spot) for spot in named.spots]
        self._views = self._filter_of(named, frame.time)
        self._markers = [_Known(AppearanceModel(spot)) for spot in named.spots]
        self._filter.predict(frame.time)
        self._remember(frame.time, spots, {})
        unknown = [math.nan] * (2 * self._count)
        return self._result(frame, spots, unknown, [], {}, named.remark)

    def _filter_of(self, named: Named, time: float, rig_error: float | None = None) -> ViewFilter:
        """Begin to follow the view of a whole body."""
        assert named.view is not None
        self._exact = named.fits
        places = np.array([(spot.x, spot.y) for spot in named.spots])
        offsets = None if named.fits else offsets_of(self._shape, named.view, places)
        return ViewFilter(self._shape, named.view, time, offsets, rig_error)

    def _follow(self, frame: _Frame, views: ViewFilter) -> MarkerResult:
        predicted = self._filter.predict(frame.time)
        views.predict(frame.time)
        spots, windows = self._look_into_windows(frame, predicted)
        seen = {index: spot for index, spot in enumerate(spots) if spot is not None}
        for a, b in combinations(list(seen), 2):
            if a in seen and b in seen and are_close(seen[a], seen[b], SAME_SPOT):
                del seen[a], seen[b]
        found = dict(zip(seen, straightened(self._lens, list(seen.values())), strict=True))
        views.contested = {i for i, marker in enumerate(self._markers) if marker.contested}
        consensus = views.weigh(places_of(found))
        if len(consensus.kept) == self._count:
            views.commit(places_of(found))
            self._doubts = 0
            self._remember(frame.time, spots, {})
            return self._result(frame, spots, predicted, windows, {})
        for marker in consensus.dropped:
            self._filter.forget(marker)
        in_image = dict(zip(found.values(), seen.values(), strict=True))
        for index, known in enumerate(self._markers):
            if not (index in seen or (known.returning and not known.unseen)):
                known.contested = PROBATION
                views.contested.add(index)
        search = Search(views, self._looks, self._motion(predicted), consensus, found)
        around = predicted if consensus.kept else ()
        status = self._search(frame, search, in_image, around)
        if not search.found and frame.time - self._newest > GIVEN_UP:
            self._start_again()
            return self._nothing('no marker in view')
        expected = self._in_image(search.finish())
        for index, (x, y, deviation) in expected.items():
            radius = frame.parameters.search_radius + math.ceil(min(3.0 * deviation, WIDEST))
            windows[index] = _window(x, y, radius, self._size)
        named = {index: in_image[spot] for index, spot in search.found.items()}
        spots = [named.get(index) for index in range(self._count)]
        self._remember(frame.time, spots, expected)
        spots = [None if index in search.suspects else spot for index, spot in enumerate(spots)]
        return self._result(frame, spots, predicted, windows, expected, status)

    @property
    def _looks(self) -> list[AppearanceModel]:
        return [marker.look for marker in self._markers]

    @property
    def _newest(self) -> float:
        """When a marker was last seen, s."""
        return max(marker.last_seen for marker in self._markers)

    def _look_into_windows(
        self, frame: _Frame, predicted: list[float]
    ) -> tuple[Detections, list[Window]]:
        """The markers to which nothing has happened, None for the others; and their windows."""
        windows: list[Window] = []
        spots: Detections = []
        for index, marker in enumerate(self._markers):
            spot = None
            window = NO_WINDOW
            if not (marker.unseen or marker.returning):
                look = marker.look
                radius = max(frame.parameters.search_radius, math.ceil(look.radius + EDGE))
                x, y = predicted[2 * index], predicted[2 * index + 1]
                window = _window(x, y, radius, self._size)
                # The background changes slowly: every third frame is enough to look at it.
                pull = look.pull if (index + self._tick) % 3 else None
                spot = frame.meter.measure(frame.cut, window, self._size, pull)
                if pull is None:
                    look.pull = frame.meter.pull
                if spot is not None and not self._is_usual(look, spot, window, frame.parameters):
                    spot = None
            windows.append(window)
            spots.append(spot)
        return spots, windows

    def _is_usual(
        self,
        look: AppearanceModel,
        spot: Detection,
        window: Window,
        parameters: MarkerTrackerParameters,
    ) -> bool:
        """Whether nothing has happened to a light, nor does the window cut it."""
        least, most = parameters.min_area, parameters.max_area or math.inf
        if not look.is_usual(spot.area, spot.spread) or not least <= spot.area <= most:
            return False
        x0, x1, y0, y1 = window
        right, bottom = self._size[0] - 1, self._size[1] - 1
        reach = look.radius + 1.0
        x, y = spot.x, spot.y
        cut_x = x - reach < x0 > 0 or x + reach > x1 < right
        return not (cut_x or y - reach < y0 > 0 or y + reach > y1 < bottom)

    def _search(
        self,
        frame: _Frame,
        search: Search,
        in_image: dict[Detection, Detection],
        around: Sequence[float],
    ) -> str:
        """Name the lights of the whole frame, some markers being known already.

        Args:
            frame: where.
            search: takes the names.
            in_image: every light where the image shows it; is added to.
            around: where the markers should be (see `_Frame.lights`).

        Returns:
            What is wrong with the frame, or nothing.
        """
        try:
            lights = frame.lights(self._lens, around)
        except GroupingError as error:
            return str(error)
        fewest = 2 if frame.time - self._newest < YOUNG else 3
        moved = not self._exact and not search.found and len(lights) >= self._count
        nameless = search.name(lights, self._clutter, min(fewest, self._count))
        if moved and len(search.found) < self._count:
            self._name_afresh(frame, search, lights)
        else:
            self._challenge(frame, search, lights, nameless)
        in_image.update(lights.measured)
        return ''

    def _name_afresh(self, frame: _Frame, search: Search, lights: Lights) -> None:
        """Name a body that is not quite its rig as at the start, or not at all.

        Its view, carried over a gap, tells too little to name a part of it.
        """
        search.found.clear()
        named = initialize(self._shape, lights, self._rig.names)
        if named.view is not None and named.certain:
            self._replace(search, named, frame.time)

    def _challenge(self, frame: _Frame, search: Search, lights: Lights, nameless: int) -> None:
        """Name the body afresh where lights have no name and markers no light for long."""
        in_doubt = min(len(search.missing), nameless) >= 2
        self._doubts = self._doubts + 1 if in_doubt else 0
        if self._doubts <= PATIENCE and search.found:
            return
        if len(lights) < self._count or not self._attempts.due(len(lights)):
            return
        views = search.views
        deviation = ANY_ROLL if search.found else math.hypot(NEARBY_ROLL, views.deviation_of(ROLL))
        named = initialize(
            self._shape, lights, self._rig.names, (views.view.roll, min(deviation, ANY_ROLL))
        )
        if named.view is None or named.view.misfit > EXACT * views.deviation:
            self._attempts.fail()
            return
        self._attempts.succeed(named)
        agrees = len(search.found) > 1 and all(
            named.spots[index] == spot for index, spot in search.found.items()
        )
        if agrees or (named.certain and not search.found) or self._attempts.agreed >= CONFIRMED:
            self._replace(search, named, frame.time)

    def _replace(self, search: Search, named: Named, time: float) -> None:
        """Take a body that was named afresh for the one that was followed."""
        assert self._views is not None
        self._views = self._filter_of(named, time, self._views.rig_error)
        search.replace(self._views, named)
        for index, marker in enumerate(self._markers):
            marker.returning = RETURNING
            marker.contested = 0
            self._filter.forget(index)
        self._attempts = Attempts(self._count)
        self._doubts = 0

    def _motion(self, predicted: list[float]) -> Motion:
        """What the markers' own motion says of this frame."""
        flat = np.array(predicted).reshape(-1, 2)
        places = self._lens.to_ideal(np.where(np.abs(flat) < _FAR_OFF, flat, 0.0)).tolist()
        return Motion(
            [
                Expectation(x, y, self._filter.deviation(index))
                for index, (x, y) in enumerate(places)
            ],
            [max(marker.unseen, marker.returning) for marker in self._markers],
        )

    def _in_image(self, expected: Mapping[int, Expectation]) -> dict[int, Expectation]:
        """Expectations where the image would show them."""
        places = self._lens.to_image(np.array([(e.x, e.y) for e in expected.values()])).tolist()
        return {
            index: Expectation(x, y, e.deviation)
            for (index, e), (x, y) in zip(expected.items(), places, strict=True)
        }

    def _remember(
        self, time: float, spots: Detections, expected: Mapping[int, Expectation]
    ) -> None:
        """Learn from a frame.

        Args:
            time: s.
            spots: of every marker.
            expected: where those should be that were not found.
        """
        positions: list[float | None] = []
        for index, (marker, spot) in enumerate(zip(self._markers, spots, strict=True)):
            if spot is None:
                marker.unseen += 1
                place = expected[index]
                # Where the others leave no doubt, the filter goes on as if it had been seen.
                sure = place.deviation < SURE_PLACE
                positions += (place.x, place.y) if sure else (None, None)
                continue
            positions += (spot.x, spot.y)
            marker.look.learn(spot)
            marker.last_seen = time
            marker.contested = max(marker.contested - 1, 0)
            marker.returning = max(marker.returning - 1, 0)
            if marker.unseen:
                marker.unseen = 0
                marker.returning = RETURNING
                if self._filter.unseen(index) > FORGOTTEN:
                    self._filter.forget(index)
        self._filter.update(positions)

    def _result(
        self,
        frame: _Frame,
        spots: Detections,
        predicted: list[float],
        windows: list[Window],
        expected: Mapping[int, Expectation],
        remark: str = '',
    ) -> MarkerResult:
        """What is told of a frame."""
        velocity, acceleration = self._filter.motions()
        markers = []
        for index, label in enumerate(self._labels):
            i, j = 2 * index, 2 * index + 1
            motion = (velocity[i], velocity[j], acceleration[i], acceleration[j])
            spot = spots[index]
            unseen = frame.time - self._markers[index].last_seen
            if spot is not None:
                x, y, area, _ = spot
                markers.append(Marker(label, MarkerState.DETECTED, x, y, *motion, area))
            elif unseen <= frame.parameters.lost_timeout and index in expected:
                x, y, _ = expected[index]
                markers.append(Marker(label, MarkerState.PREDICTED, x, y, *motion))
            else:
                markers.append(Marker(label, MarkerState.LOST))
        roll = math.nan
        if self._wings is not None:
            left, right = markers[self._wings[0]], markers[self._wings[1]]
            roll = math.atan2(right.y - left.y, right.x - left.x)
        status = remark if None not in spots else _status(markers, remark)
        predictions = tuple(zip(predicted[::2], predicted[1::2], strict=True))
        has_wings = self._wings is not None
        return MarkerResult(tuple(markers), roll, status, tuple(windows), predictions, has_wings)

    def _nothing(self, status: str) -> MarkerResult:
        lost = tuple(Marker(label, MarkerState.LOST) for label in self._labels)
        return MarkerResult(lost, status=status, has_wings=self._wings is not None)


def _wings(rig: MarkerRig) -> tuple[int, int] | None:
    names = rig.names
    if 'left_wing' in names and 'right_wing' in names:
        return names.index('left_wing'), names.index('right_wing')
    return None


def _lens_of(size: tuple[int, int], camera: CameraModel | None) -> Lens:
    """The lens of a camera, if it is calibrated for images of that size."""
    if camera is not None:
        try:
            camera.check(*size)
        except CalibrationError:
            camera = None
    return Lens(size, camera)


def _window(x: float, y: float, radius: int, size: tuple[int, int]) -> Window:
    """As `tracking.window_around`, in less time; the place may be anywhere."""
    if not (-_FAR_OFF < x < _FAR_OFF and -_FAR_OFF < y < _FAR_OFF):
        return NO_WINDOW
    column, row = math.floor(x + 0.50001), math.floor(y + 0.50001)
    x0, x1, y0, y1 = column - radius, column + radius, row - radius, row + radius
    width, height = size
    return Window(
        x0 if x0 > 0 else 0,
        x1 if x1 < width else width - 1,
        y0 if y0 > 0 else 0,
        y1 if y1 < height else height - 1,
    )


def _status(markers: Sequence[Marker], remark: str) -> str:
    states = Counter(marker.state for marker in markers)
    counts = ', '.join(
        f'{states[state]} {state.name.lower()}' for state in MarkerState if states[state]
    )
    return f'{counts} ({remark})' if remark else counts

"""A body's markers followed under their names, whatever hides, joins or imitates them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.appearance import AppearanceModel
from mvuav_ros.vision.markers.assignment import Clutter, Expectation, Lights, initialize
from mvuav_ros.vision.markers.blobs import Blobs
from mvuav_ros.vision.markers.centroid import CentroidMeter, Detection, cutter
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
from mvuav_ros.vision.markers.search import FORGOTTEN, Search, are_close
from mvuav_ros.vision.markers.thesis_tracker import WHOLE_FRAMES
from mvuav_ros.vision.markers.view import WeakPerspective
from mvuav_ros.vision.markers.view_filter import ViewFilter
from mvuav_ros.vision.rig import MarkerRig

EDGE = 4.0
"""px of dark that a window shows around a light."""
SAME_SPOT = 3.0
"""Two markers closer than this (px) are one light."""
CHECKED_EVERY = 30
"""Frames after which even markers that look well are held against the rig."""
RETURNING = 2
"""Frames after its return in which a marker is named by the geometry: its motion, by which its
window is placed, is not known yet."""
SURE_PLACE = 2.0
"""px (1 sigma): a place known this well stands in for a measurement."""
GIVEN_UP = 10.0
"""Seconds without any marker after which nothing is known of the body any more."""
WIDEST = 200.0
"""px, by which a search window grows at most."""
_FAR_OFF = 1e6

Detections = list[Detection | None]


class IdentityTracker:
    """Three whole frames, then a window for each marker; the whole frame whenever in doubt.

    A marker that is alone in its window, where it is expected and as it usually looks, is taken
    (the fast way, and the usual one). If any is not, the bright pieces of the whole frame are
    named by the body's geometry (see `Search`): the markers in sight give the view, the view
    gives the others' places and how uncertain those are, and a piece gets a name only where no
    other fits.
    """

    def __init__(self, rig: MarkerRig) -> None:
        self._rig = rig
        self._count = len(rig.names)
        self._labels: list[int] = list(range(self._count))
        if rig.names == TANKER_NAMES:
            self._labels = [*TANKER_LABELS]
        self._wings = _wings(rig)
        self._size = (0, 0)
        self._start_again()

    def _start_again(self) -> None:
        self._filter = MotionPredictor(self._count)
        self._view_filter: ViewFilter | None = None
        self._clutter = Clutter()
        self._whole_frames = 0
        self._since_check = 0
        self._looks: list[AppearanceModel] = []
        self._last_seen = [-math.inf] * self._count
        self._unseen = [0] * self._count
        self._returning = [0] * self._count
        self._all_seen_at = -math.inf
        self._all_places: Sequence[float | None] = ()

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
            self._shape = WeakPerspective.of(self._rig, *size)
        meter = CentroidMeter(parameters.threshold, parameters.weighted)
        if self._whole_frames < WHOLE_FRAMES:
            return self._begin(image, time, parameters, meter)
        predicted = self._filter.predict(time)
        spots, windows = self._look_into_windows(image, predicted, parameters, meter)
        self._since_check += 1
        if _doubtful(spots) or self._since_check > CHECKED_EVERY:
            self._since_check = 0
            self._look_back(spots)
        if _doubtful(spots):
            return self._search(image, time, parameters, meter, predicted, spots, windows)
        self._remember(time, spots, {})
        return self._result(time, spots, predicted, windows, {}, parameters)

    def _look_into_windows(
        self,
        image: Image,
        predicted: list[float],
        parameters: MarkerTrackerParameters,
        meter: CentroidMeter,
    ) -> tuple[Detections, list[Window]]:
        """The markers to which nothing has happened, None for the others; and their windows."""
        cut = cutter(image)
        size = self._size
        right, bottom = size[0] - 1, size[1] - 1
        least, most = parameters.min_area, parameters.max_area or math.inf
        windows: list[Window] = []
        spots: Detections = []
        for index, look in enumerate(self._looks):
            spot = None
            window = NO_WINDOW
            if not (self._unseen[index] or self._returning[index]):
                radius = max(parameters.search_radius, math.ceil(look.radius + EDGE))
                window = _window(predicted[2 * index], predicted[2 * index + 1], radius, size)
                # The background changes slowly: every third frame is enough to look at it.
                pull = look.pull if (index + self._since_check) % 3 else None
                spot = meter.measure(cut, window, size, pull)
                if pull is None:
                    look.pull = meter.pull
            windows.append(window)
            if spot is not None:
                x, y, area, spread = spot
                x0, x1, y0, y1 = window
                reach = look.radius + 1.0
                if (
                    not look.is_usual(area, spread)
                    or not least <= area <= most
                    # Cut by the window, though not by the frame.
                    or x - reach < x0 > 0
                    or x + reach > x1 < right
                    or y - reach < y0 > 0
                    or y + reach > y1 < bottom
                ):
                    spot = None
            spots.append(spot)
        return spots, windows

    def _look_back(self, spots: Detections) -> None:
        """Take the view from the last frame that showed all markers, if that is news.

        Args:
            spots: a marker that must have been something else is taken out of them.
        """
        view_filter = self._view_filter
        assert view_filter is not None
        if self._all_seen_at <= view_filter.time:
            return
        positions = np.array(self._all_places).reshape(-1, 2)
        velocity = np.array(self._filter.motions()[0]).reshape(-1, 2)
        wrong = view_filter.refresh(positions, velocity, self._all_seen_at)
        if wrong is not None:
            self._filter.forget(wrong)
            self._last_seen[wrong] = -math.inf
            spots[wrong] = None

    def _begin(
        self,
        image: Image,
        time: float,
        parameters: MarkerTrackerParameters,
        meter: CentroidMeter,
    ) -> MarkerResult:
        """Name all markers in a whole frame."""
        try:
            lights = Lights(Blobs(image.gray(), parameters), cutter(image), meter)
        except GroupingError as error:
            self._start_again()
            return self._nothing(str(error))
        named = initialize(self._shape, lights, self._rig.names, self._view_filter)
        if isinstance(named, str):
            self._start_again()
            return self._nothing(named)
        if self._filter.time is not None and self._jumped(named.spots, named.view.scale):
            # Another way of naming the same lights than a frame ago: neither can be believed.
            self._start_again()
            return self._nothing('the markers were named in two ways')
        self._filter.predict(time)
        self._whole_frames += 1
        self._view_filter = ViewFilter(self._shape, named.view, time, self._view_filter)
        spots: Detections = [*named.spots]
        if not self._looks:
            self._looks = [AppearanceModel(spot) for spot in named.spots]
        self._remember(time, spots, {})
        if not named.certain and self._whole_frames < WHOLE_FRAMES:
            return self._nothing(f'{len(lights)} lights in view, not yet certain')
        unknown = [math.nan] * (2 * self._count)
        return self._result(time, spots, unknown, [], {}, parameters, named.remark)

    def _jumped(self, spots: Sequence[Detection], scale: float) -> bool:
        """Whether a marker lies where only another one can have been a frame ago."""
        last = self._filter.positions()
        return any(
            math.hypot(spot.x - last[2 * index], spot.y - last[2 * index + 1]) > 0.5 * scale
            for index, spot in enumerate(spots)
        )

    def _search(
        self,
        image: Image,
        time: float,
        parameters: MarkerTrackerParameters,
        meter: CentroidMeter,
        predicted: list[float],
        spots: Detections,
        windows: list[Window],
    ) -> MarkerResult:
        """Name the lights of the whole frame, some markers being known already."""
        view_filter = self._view_filter
        assert view_filter is not None
        found = {index: spot for index, spot in enumerate(spots) if spot is not None}
        for a, b in combinations(list(found), 2):
            if a in found and b in found and are_close(found[a], found[b], SAME_SPOT):
                del found[a], found[b]
        unseen = [max(pair) for pair in zip(self._unseen, self._returning, strict=True)]
        search = Search(view_filter, time, self._looks, self._filter, predicted, unseen, found)
        status = ''
        try:
            lights = Lights(Blobs(image.gray(), parameters), cutter(image), meter)
        except GroupingError as error:
            status = str(error)
        else:
            search.name(lights, self._clutter)
            if self._all_gone(time, search, parameters) and len(lights) >= self._count:
                whole = initialize(self._shape, lights, self._rig.names, view_filter)
                if not isinstance(whole, str) and (whole.certain or not found):
                    self._start_again()
                    self._view_filter = view_filter
                    return self._begin(image, time, parameters, meter)
        if not found and time - max(self._last_seen) > GIVEN_UP:
            self._start_again()
            return self._nothing('no marker in view')
        expected = search.finish()
        for index, (x, y, deviation) in expected.items():
            radius = parameters.search_radius + math.ceil(min(3.0 * deviation, WIDEST))
            windows[index] = _window(x, y, radius, self._size)
        spots = [found.get(index) for index in range(self._count)]
        self._remember(time, spots, expected)
        return self._result(time, spots, predicted, windows, expected, parameters, status)

    def _all_gone(self, time: float, search: Search, parameters: MarkerTrackerParameters) -> bool:
        """Whether to look for the whole body as at the start: none found, or one long lost."""
        longest = max((time - self._last_seen[index] for index in search.missing), default=0.0)
        return not search.found or longest > parameters.lost_timeout

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
        for index, spot in enumerate(spots):
            if spot is not None:
                positions += (spot.x, spot.y)
                self._looks[index].learn(spot)
                self._last_seen[index] = time
                self._returning[index] = max(self._returning[index] - 1, 0)
                if self._unseen[index]:
                    self._unseen[index] = 0
                    self._returning[index] = RETURNING
                    if self._filter.unseen(index) > FORGOTTEN:
                        self._filter.forget(index)
                continue
            self._unseen[index] += 1
            place = expected[index]
            # Where the others leave no doubt, the filter goes on as if it had been seen.
            sure = place.deviation < SURE_PLACE
            positions += (place.x, place.y) if sure else (None, None)
        self._filter.update(positions)
        if None not in spots:
            self._all_seen_at = time
            self._all_places = positions

    def _result(
        self,
        time: float,
        spots: Detections,
        predicted: list[float],
        windows: list[Window],
        expected: Mapping[int, Expectation],
        parameters: MarkerTrackerParameters,
        remark: str = '',
    ) -> MarkerResult:
        """What is told of a frame."""
        velocity, acceleration = self._filter.motions()
        markers = []
        for index, label in enumerate(self._labels):
            i, j = 2 * index, 2 * index + 1
            motion = (velocity[i], velocity[j], acceleration[i], acceleration[j])
            spot = spots[index]
            if spot is not None:
                x, y, area, _ = spot
                markers.append(Marker(label, MarkerState.DETECTED, x, y, *motion, area))
            elif time - self._last_seen[index] <= parameters.lost_timeout:
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


def _doubtful(spots: Detections) -> bool:
    """Whether a marker is missing, or two have the same spot."""
    known = [spot for spot in spots if spot is not None]
    if len(known) < len(spots):
        return True
    known.sort()
    last_x = -math.inf
    for spot in known:
        if spot.x - last_x < SAME_SPOT:
            return any(are_close(a, b, SAME_SPOT) for a, b in combinations(known, 2))
        last_x = spot.x
    return False


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

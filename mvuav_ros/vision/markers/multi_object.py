"""Any number of lights without names, each followed under a number of its own."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.blobs import Blobs
from mvuav_ros.vision.markers.centroid import CentroidMeter, Detection, cutter
from mvuav_ros.vision.markers.grouping import GroupingError
from mvuav_ros.vision.markers.kalman import Array
from mvuav_ros.vision.markers.prediction import MotionPredictor
from mvuav_ros.vision.markers.results import Label, Marker, MarkerResult, MarkerState

GATE = 4.0
"""Deviations from its prediction at which a light is another one."""
ALONE = 0.45
"""Part of the distance to the nearest other light within which a light is still itself."""
WIDEST = 60.0
"""px that a light may lie off its prediction, unless all jump together."""
_SAME_JUMP = 5.0
_FAR = 1e6


@dataclass
class Light:
    """A light under its number.

    Attributes:
        id: from 1 up, never given twice.
        area: usual, px.
        last_seen: s.
    """

    id: int
    area: float
    last_seen: float


class MultiObjectTracker:
    """Every light of the frame, as persistent as its motion allows.

    The lights of a frame are given to the known ones so that the squared distances from the
    predictions, over their variances, are least in sum; where several are new or hidden at once
    the others' motion is a prediction too (`MotionPredictor` shares what they have in common). A
    light out of sight is predicted for ``lost_timeout`` and then forgotten; two that run into
    one are both kept that long.
    """

    def __init__(self) -> None:
        self._filter = MotionPredictor(0)
        self._lights: list[Light] = []
        self._newest_id = 0

    def track(self, image: Image, time: float, parameters: MarkerTrackerParameters) -> MarkerResult:
        """Find the lights of the next frame.

        Args:
            image: the frame.
            time: its stamp, s, later than the last frame's.
            parameters: may change from frame to frame.
        """
        predicted = self._filter.predict(time)
        places = np.array(predicted).reshape(-1, 2)
        status = ''
        spots: list[Detection] = []
        try:
            blobs = Blobs(image.gray(), parameters)
        except GroupingError as error:
            status = str(error)
        else:
            meter = CentroidMeter(parameters.threshold, parameters.weighted)
            cut = cutter(image)
            spots = [blobs.measure(box, cut, meter) for box in blobs.boxes]
        given = self._give(places, spots, parameters)
        self._update(time, given, spots, parameters)
        known = {number: index for index, number in given.items()}
        for number, spot in enumerate(spots):
            if number not in known:
                self._add(time, spot)
                given[len(self._lights) - 1] = number
        return self._result(given, spots, places, status)

    def _give(
        self, places: Array, spots: list[Detection], parameters: MarkerTrackerParameters
    ) -> dict[int, int]:
        """Which known light has which spot."""
        if not self._lights or not spots:
            return {}
        seen = np.array([(spot.x, spot.y) for spot in spots])
        deviations = np.array([self._filter.deviation(i) for i in range(len(self._lights))])
        places = places + _common_shift(places, seen)
        apart = np.hypot(*(places[:, None] - seen).transpose(2, 0, 1))
        reach = np.maximum(parameters.search_radius, GATE * deviations)
        # A light that is alone far and wide may jump further than one among others.
        alone = ALONE * np.minimum(_nearest_other(places), _nearest_other(seen).min(initial=_FAR))
        reach = np.minimum(np.maximum(reach, alone), WIDEST)
        cost = (apart / np.maximum(deviations, 1.0)[:, None]) ** 2
        # A light that changes its size is likelier to be another one.
        areas = np.array([light.area for light in self._lights])[:, None] + 4.0
        sizes = np.array([spot.area for spot in spots]) + 4.0
        cost += (3.0 * np.log(sizes / areas)) ** 2
        cost[apart > reach[:, None]] = _FAR
        rows, columns = linear_sum_assignment(cost)
        return {
            int(row): int(column)
            for row, column in zip(rows, columns, strict=True)
            if cost[row, column] < _FAR
        }

    def _update(
        self,
        time: float,
        given: dict[int, int],
        spots: list[Detection],
        parameters: MarkerTrackerParameters,
    ) -> None:
        """Measure the known lights, and forget those that are gone; ``given`` is renumbered."""
        positions: list[float | None] = []
        for index, light in enumerate(self._lights):
            number = given.get(index)
            if number is None:
                positions += (None, None)
                continue
            spot = spots[number]
            positions += (spot.x, spot.y)
            light.last_seen = time
            light.area += 0.2 * (spot.area - light.area)
        if self._lights:
            self._filter.update(positions)
        gone = [
            index
            for index, light in enumerate(self._lights)
            if time - light.last_seen > parameters.lost_timeout
        ]
        for index in reversed(gone):
            del self._lights[index]
            self._filter.remove(index)
            moved = {i - (i > index): number for i, number in given.items()}
            given.clear()
            given.update(moved)

    def _add(self, time: float, spot: Detection) -> None:
        self._newest_id += 1
        self._lights.append(Light(self._newest_id, spot.area, time))
        self._filter.add((spot.x, spot.y))

    def _result(
        self, given: dict[int, int], spots: list[Detection], places: Array, status: str
    ) -> MarkerResult:
        velocity, acceleration = self._filter.motions()
        now = self._filter.positions()
        markers = []
        for index in range(len(self._lights)):
            i, j = 2 * index, 2 * index + 1
            motion = (velocity[i], velocity[j], acceleration[i], acceleration[j])
            number = given.get(index)
            if number is not None:
                spot = spots[number]
                state, x, y, area = MarkerState.DETECTED, spot.x, spot.y, float(spot.area)
            else:
                state, x, y, area = MarkerState.PREDICTED, now[i], now[j], math.nan
            markers.append(Marker(Label.UNLABELLED, state, x, y, *motion, area))
        hidden = len(markers) - len(given)
        if not markers:
            status = status or 'no light in view'
        elif hidden and not status:
            status = f'{len(given)} detected, {hidden} predicted'
        ids = tuple(light.id for light in self._lights)
        return MarkerResult(tuple(markers), status=status, ids=ids)


def _nearest_other(places: Array) -> Array:
    """The distance from each of (n, 2) places to the nearest other one, px; far if alone."""
    apart = np.hypot(*(places[:, None] - places).transpose(2, 0, 1))
    np.fill_diagonal(apart, _FAR)
    return np.asarray(apart.min(axis=1, initial=_FAR))


def _common_shift(places: Array, seen: Array) -> Array:
    """A jump that most lights made together, as by a push to the camera, (2,) px; or none.

    Args:
        places: (n, 2), predicted.
        seen: (m, 2), of this frame.
    """
    count = len(places)
    none = np.zeros(2)
    if count < 3 or len(seen) < 3:
        return none
    shifts = (seen[None] - places[:, None]).reshape(-1, 2)
    shifts = np.vstack((none, shifts[np.hypot(*shifts.T) < 3 * WIDEST]))
    moved = places + shifts[:, None]
    apart = np.hypot(*(moved[:, :, None] - seen).transpose(3, 0, 1, 2)).min(axis=2)
    fitting = (apart < _SAME_JUMP).sum(axis=1)
    best = int(np.argmax(fitting))
    if fitting[best] < max(3, 0.6 * count) or fitting[best] < fitting[0] + 2:
        return none
    return np.asarray(shifts[best])

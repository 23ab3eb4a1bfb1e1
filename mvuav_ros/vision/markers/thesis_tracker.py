"""Five markers followed from frame to frame in small windows (Appendix C)."""

from __future__ import annotations

import math
from collections import Counter

import cv2

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.centroid import CentroidMeter, cutter
from mvuav_ros.vision.markers.detection import area_fits, detect
from mvuav_ros.vision.markers.labelling import roll_of
from mvuav_ros.vision.markers.motion import Motion
from mvuav_ros.vision.markers.results import (
    LOST_TANKER,
    NO_WINDOW,
    TANKER_LABELS,
    Cluster,
    Marker,
    MarkerResult,
    MarkerState,
    Window,
)
from mvuav_ros.vision.point_operations import threshold

WHOLE_FRAMES = 3
"""Frames searched whole before tracking: an acceleration needs three positions."""


class ThesisTracker:
    """Three whole frames, then a window around each marker's predicted position.

    Where the thesis's program stops, this one goes on: a window that leaves the image is
    clipped; a marker that is not in its window is ``predicted``, and ``lost`` once it has not
    been seen for ``lost_timeout``. While any marker is lost every frame is searched whole as
    well, and as soon as all five are found there the tracker starts again from them.
    """

    def __init__(self) -> None:
        self._start_again()

    def _start_again(self) -> None:
        self._motions = [Motion() for _ in TANKER_LABELS]
        self._unseen = [0] * len(TANKER_LABELS)
        self._lost = [False] * len(TANKER_LABELS)
        self._whole_frames = 0

    def track(self, image: Image, time: float, parameters: MarkerTrackerParameters) -> MarkerResult:
        """Find the five markers in the next frame.

        Args:
            image: the frame.
            time: its stamp, s, later than the last frame's.
            parameters: may change from frame to frame.
        """
        if self._whole_frames < WHOLE_FRAMES:
            return self._search_whole_frame(image, time, parameters)
        result = self._search_windows(image, time, parameters)
        if not any(self._lost):
            return result
        found = detect(image, parameters)
        if found.markers is LOST_TANKER:
            return result
        self._start_again()
        return self._follow(found, time)

    def _search_whole_frame(
        self, image: Image, time: float, parameters: MarkerTrackerParameters
    ) -> MarkerResult:
        found = detect(image, parameters)
        if found.markers is LOST_TANKER:
            self._start_again()
            return found
        return self._follow(found, time)

    def _follow(self, found: MarkerResult, time: float) -> MarkerResult:
        """Take a whole frame's markers as the newest positions."""
        self._whole_frames += 1
        markers = []
        for marker, motion in zip(found.markers, self._motions, strict=True):
            motion.add(time, marker.x, marker.y)
            markers.append(
                _seen(marker.label, Cluster(marker.x, marker.y, int(marker.area)), motion)
            )
        return MarkerResult(tuple(markers), found.roll, found.status)

    def _search_windows(
        self, image: Image, time: float, parameters: MarkerTrackerParameters
    ) -> MarkerResult:
        markers: list[Marker] = []
        windows: list[Window] = []
        predictions: list[tuple[float, float]] = []
        for index, motion in enumerate(self._motions):
            if self._lost[index]:
                markers.append(LOST_TANKER[index])
                windows.append(NO_WINDOW)
                predictions.append((math.nan, math.nan))
                continue
            x, y = motion.predict(time, parameters.prediction, self._unseen[index])
            window = window_around(x, y, parameters.search_radius, image.width, image.height)
            cluster = measure_window(image, window, parameters)
            label = TANKER_LABELS[index]
            if cluster is not None:
                motion.add(time, cluster.x, cluster.y)
                self._unseen[index] = 0
                marker = _seen(label, cluster, motion)
            elif time - motion.last_seen > parameters.lost_timeout:
                self._lost[index] = True
                marker = LOST_TANKER[index]
            else:
                self._unseen[index] += 1
                marker = Marker(
                    label, MarkerState.PREDICTED, x, y, *motion.velocity, *motion.acceleration
                )
            markers.append(marker)
            windows.append(window)
            predictions.append((x, y))
        return MarkerResult(
            tuple(markers), roll_of(markers), _status(markers), tuple(windows), tuple(predictions)
        )


def window_around(x: float, y: float, radius: int, width: int, height: int) -> Window:
    """The window of 2 radius + 1 px on a side around a position (px), clipped to the image.

    The centre is rounded to the nearest pixel, halves up; a hair below a half counts as one,
    since stamps of whole nanoseconds make equal time steps unequal in the eighth digit.
    """
    column, row = math.floor(x + 0.5 + 1e-5), math.floor(y + 0.5 + 1e-5)
    return Window(
        max(column - radius, 0),
        min(column + radius, width - 1),
        max(row - radius, 0),
        min(row + radius, height - 1),
    )


def measure_window(
    image: Image, window: Window, parameters: MarkerTrackerParameters
) -> Cluster | None:
    """The bright pixels of a window as one cluster; None where there are too few or too many."""
    x0, x1, y0, y1 = window
    if x1 < x0 or y1 < y0:
        return None
    if parameters.weighted:
        meter = CentroidMeter(parameters.threshold, weighted=True)
        spot = meter.measure(cutter(image), window, (image.width, image.height))
        if spot is None or not area_fits(spot.area, parameters):
            return None
        return Cluster(spot.x, spot.y, spot.area)
    gray = image.gray_window(slice(y0, y1 + 1), slice(x0, x1 + 1))
    # Every bright pixel counts 255; OpenCV is slower when it is asked to count ones.
    moments = cv2.moments(threshold(gray, parameters.threshold))
    mass = moments['m00']
    area = int(mass / 255)
    if area == 0 or not area_fits(area, parameters):
        return None
    return Cluster(x0 + moments['m10'] / mass, y0 + moments['m01'] / mass, area)


def _seen(label: int, cluster: Cluster, motion: Motion) -> Marker:
    return Marker(
        label,
        MarkerState.DETECTED,
        cluster.x,
        cluster.y,
        *motion.velocity,
        *motion.acceleration,
        cluster.area,
    )


def _status(markers: list[Marker]) -> str:
    if all(marker.state is MarkerState.DETECTED for marker in markers):
        return ''
    states = Counter(marker.state for marker in markers)
    return ', '.join(
        f'{states[state]} {state.name.lower()}' for state in MarkerState if states[state]
    )

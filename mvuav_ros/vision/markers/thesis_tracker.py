"""The thesis's marker programs: whole frames (Appendices A and B), then small windows (C)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

import cv2

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.lights import (
    CentroidMeter,
    Detection,
    GroupingError,
    Light,
    Point,
    area_fits,
    find_lights,
)
from mvuav_ros.vision.markers.marker_results import (
    LOST_TANKER,
    NO_WINDOW,
    TANKER_LABELS,
    Label,
    Marker,
    MarkerResult,
    MarkerState,
    Window,
    counts_of,
    roll_of,
)
from mvuav_ros.vision.point_operations import threshold

DOUBTFUL_AREA = 0.5
"""A sixth cluster larger than this part of the fifth could be a marker just as well."""


def label_five(clusters: Sequence[Detection | Light]) -> tuple[int, int, int, int, int]:
    """Name five clusters by the ten distances between them.

    The greatest distance of all joins the wings, the greatest among the other three points the
    stabilizers; the point that remains is the rudder. Of a pair, left is the one that comes
    first in the scan (the smaller x), so the names hold for roll between -90° and 90°.

    Returns:
        Indices into the clusters, which are in scan order, of the five `TANKER_LABELS`.

    Raises:
        ValueError: there are not exactly five.
    """
    if len(clusters) != 5:
        raise ValueError(f'labels need five clusters, not {len(clusters)}')

    def squared_distance(pair: tuple[int, int]) -> float:
        a, b = clusters[pair[0]], clusters[pair[1]]
        return (a.x - b.x) ** 2 + (a.y - b.y) ** 2

    left_wing, right_wing = max(combinations(range(5), 2), key=squared_distance)
    others = [i for i in range(5) if i not in (left_wing, right_wing)]
    left_stabilizer, right_stabilizer = max(combinations(others, 2), key=squared_distance)
    (rudder,) = (i for i in others if i not in (left_stabilizer, right_stabilizer))
    return left_wing, left_stabilizer, rudder, right_stabilizer, right_wing


def _clusters(image: Image, parameters: MarkerTrackerParameters) -> list[Detection]:
    return [Detection(x, y, int(area)) for x, y, area in find_lights(image, parameters).tolist()]


def detect(image: Image, parameters: MarkerTrackerParameters) -> MarkerResult:
    """Find and label the five markers in a whole frame (Appendix A).

    The thesis's program takes the first five groups of the scan, so that one hot pixel at the left
    pushes the right wing out; here the five of greatest area are taken. All are lost where there
    are fewer groups, and where the sixth largest is too much like the fifth.
    """
    try:
        clusters = _clusters(image, parameters)
    except GroupingError as error:
        return MarkerResult(LOST_TANKER, status=str(error))
    if len(clusters) < 5:
        return MarkerResult(LOST_TANKER, status=f'{len(clusters)} of 5 markers in view')
    status = ''
    if len(clusters) > 5:
        by_area = sorted(range(len(clusters)), key=lambda i: -clusters[i].area)
        if clusters[by_area[5]].area > DOUBTFUL_AREA * clusters[by_area[4]].area:
            return MarkerResult(
                LOST_TANKER, status=f'{len(clusters)} clusters in view, five do not stand out'
            )
        status = f'{len(clusters)} clusters in view, the five largest were used'
        clusters = [clusters[i] for i in sorted(by_area[:5])]
    markers = tuple(
        _detected(label, clusters[index])
        for label, index in zip(TANKER_LABELS, label_five(clusters), strict=True)
    )
    return MarkerResult(markers, roll_of(markers[0], markers[-1]), status)


def detect_any(image: Image, parameters: MarkerTrackerParameters) -> MarkerResult:
    """Find any number of clusters, without names (the purpose of Appendix B)."""
    try:
        clusters = _clusters(image, parameters)
    except GroupingError as error:
        return MarkerResult((), status=str(error))
    markers = tuple(_detected(Label.UNLABELLED, cluster) for cluster in clusters)
    return MarkerResult(markers, status='' if markers else 'no cluster in view')


def _detected(label: int, cluster: Detection) -> Marker:
    """A cluster as a marker that does not move."""
    return Marker(label, MarkerState.DETECTED, cluster.x, cluster.y, area=cluster.area)


UNKNOWN: Point = (math.nan, math.nan)


class Motion:
    """The positions at which a marker was last seen.

    Times are seconds on the images' own clock: the thesis's program took its processing time
    for the time step, so that one slow frame threw the estimate off by 8 to 10 px.
    """

    def __init__(self) -> None:
        self._seen: list[tuple[float, float, float]] = []  # s, px and px, the newest three
        self.last_seen = -math.inf  # s
        self.unseen = 0  # frames since then
        self.is_lost = False  # whether it has been out of sight for too long
        # px/s between the two newest positions (eqs 3.14, 3.15); NaN before there are two.
        self.velocity = UNKNOWN
        # px/s² from the three newest ones (eqs 3.16, 3.17), each velocity being that of its
        # interval's middle; NaN before there are three.
        self.acceleration = UNKNOWN

    def add(self, time: float, x: float, y: float) -> None:
        """Append a position (px), later than the last one."""
        seen, self.last_seen, self.unseen = self._seen, time, 0
        seen.append((time, x, y))
        if len(seen) < 2:
            return
        t1, x1, y1 = seen[-2]
        newer = time - t1
        vx, vy = self.velocity = ((x - x1) / newer, (y - y1) / newer)
        if len(seen) < 3:
            return
        t0, x0, y0 = seen[-3]
        older, between = t1 - t0, 0.5 * (time - t0)
        self.acceleration = ((vx - (x1 - x0) / older) / between, (vy - (y1 - y0) / older) / between)
        del seen[:-2]

    def predict(self, time: float, method: str) -> Point:
        """Where the marker should be (px) at a time (s) after it was last seen.

        The method is ``none``, ``velocity`` (eq. 4.1), ``acceleration`` (eqs 3.18, 4.2), or
        ``acceleration_program``: Appendix C as coded, whose acceleration is (older minus newer
        velocity) over two time steps, a smoother instead of an extrapolator. A marker out of sight
        for some frames is carried on by its velocity: its acceleration cannot be trusted so long.
        """
        _, x, y = self._seen[-1]
        vx, vy = self.velocity
        if method == 'none' or self.velocity is UNKNOWN:
            return x, y
        ahead = time - self.last_seen
        x, y = x + vx * ahead, y + vy * ahead
        ax, ay = self.acceleration
        if method == 'velocity' or self.unseen or self.acceleration is UNKNOWN:
            return x, y
        half = 0.5 * ahead * ahead
        if method == 'acceleration_program':
            half *= -0.5
        return x + ax * half, y + ay * half


WHOLE_FRAMES = 3  # Frames searched whole before tracking: an acceleration needs three positions


class ThesisTracker:
    """Three whole frames, then a window around each marker's predicted position.

    Where the thesis's program stops, this one goes on: a marker that is not in its window is
    ``predicted``, and ``lost`` once it has not been seen for ``lost_timeout``. While any is lost
    every frame is searched whole as well, and it starts again from five found there. Two markers
    whose windows meet may go on with one light, as in the program; the status says so.
    """

    def __init__(self) -> None:
        self._size = (0, 0)
        self._start_again()

    def _start_again(self) -> None:
        self._motions = [Motion() for _ in TANKER_LABELS]
        self._whole_frames = 0

    def track(self, image: Image, time: float, parameters: MarkerTrackerParameters) -> MarkerResult:
        """Find the five markers in the next frame, of a later time (s) than the last one."""
        if self._size != (image.width, image.height):
            self._size = image.width, image.height
            self._start_again()
        if self._whole_frames < WHOLE_FRAMES:
            found = detect(image, parameters)
            if found.markers is LOST_TANKER:
                self._start_again()
                return found
            return self._follow(found, time)
        result = self._search_windows(image, time, parameters)
        if not any(motion.is_lost for motion in self._motions):
            return result
        found = detect(image, parameters)
        if found.markers is LOST_TANKER:
            return result
        self._start_again()
        return self._follow(found, time)

    def _follow(self, found: MarkerResult, time: float) -> MarkerResult:
        """Take a whole frame's markers as the newest positions."""
        self._whole_frames += 1
        markers = []
        for marker, motion in zip(found.markers, self._motions, strict=True):
            motion.add(time, marker.x, marker.y)
            markers.append(_moving(marker, motion))
        return MarkerResult(tuple(markers), found.roll, found.status)

    def _search_windows(
        self, image: Image, time: float, parameters: MarkerTrackerParameters
    ) -> MarkerResult:
        rows = [self._look_for(label, image, time, parameters) for label in TANKER_LABELS]
        markers, windows, predictions = zip(*rows, strict=True)
        lights = [marker[2:4] for marker in markers if marker.state is MarkerState.DETECTED]
        status = '' if len(lights) == len(markers) else counts_of(markers)
        roll = roll_of(markers[0], markers[-1])
        result = MarkerResult(markers, roll, status, windows, predictions)
        # The program does not distinguish names whose windows have met.
        shared = len(lights) - len(set(lights))
        remark = f"{shared} of the names are on another one's light"
        return result.remarked(remark) if shared else result

    def _look_for(
        self, label: Label, image: Image, time: float, parameters: MarkerTrackerParameters
    ) -> tuple[Marker, Window, Point]:
        """One marker, its window, and where it was expected."""
        motion = self._motions[label]
        if motion.is_lost:
            return LOST_TANKER[label], NO_WINDOW, UNKNOWN
        x, y = motion.predict(time, parameters.prediction)
        window = Window.around(x, y, parameters.search_radius, (image.width, image.height))
        cluster = measure_window(image, window, parameters)
        if cluster is not None:
            motion.add(time, cluster.x, cluster.y)
            marker = _detected(label, cluster)
        elif time - motion.last_seen > parameters.lost_timeout:
            motion.is_lost = True
            return LOST_TANKER[label], window, (x, y)
        else:
            motion.unseen += 1
            marker = Marker(label, MarkerState.PREDICTED, x, y)
        return _moving(marker, motion), window, (x, y)


def measure_window(
    image: Image, window: Window, parameters: MarkerTrackerParameters
) -> Detection | None:
    """The bright pixels of a window as one cluster; None where there are too few or too many."""
    x0, x1, y0, y1 = window
    if x1 < x0 or y1 < y0:
        return None
    if parameters.weighted:
        spot = CentroidMeter(image, parameters.threshold, weighted=True).measure(window)
        if spot is None or not area_fits(spot.area, parameters):
            return None
        return spot
    gray = image.gray_window(slice(y0, y1 + 1), slice(x0, x1 + 1))
    # Every bright pixel counts 255; OpenCV is slower when it is asked to count ones.
    moments = cv2.moments(threshold(gray, parameters.threshold))
    mass = moments['m00']
    area = int(mass / 255)
    if area == 0 or not area_fits(area, parameters):
        return None
    return Detection(x0 + moments['m10'] / mass, y0 + moments['m01'] / mass, area)


def _moving(marker: Marker, motion: Motion) -> Marker:
    label, state, x, y = marker[:4]
    return Marker(label, state, x, y, *motion.velocity, *motion.acceleration, marker.area)

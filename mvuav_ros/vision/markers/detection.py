"""Markers in a whole frame: pixels grouped, and named by distances (Appendices A and B)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.centroid import CentroidMeter
from mvuav_ros.vision.markers.lights import (
    MAX_BLOBS,
    Blobs,
    GroupingError,
    area_fits,
    count_bright,
)
from mvuav_ros.vision.markers.marker_results import (
    LOST_TANKER,
    TANKER_LABELS,
    Cluster,
    Label,
    Marker,
    MarkerResult,
    MarkerState,
    roll_of,
)
from mvuav_ros.vision.point_operations import Mask, threshold

Array = NDArray[np.float64]

MAX_CLUSTERS = 1000


def group_mask(mask: Mask, grouping_distance: int) -> NDArray[np.float64]:
    """Group bright pixels around seeds: the first pixel left, with all within T of it.

    The scan goes column by column, each from the top. A group is every pixel left with x in
    [x_seed, x_seed + T] and |y - y_seed| <= T, bounds included, where T is the grouping distance,
    px. A light wider than T falls into several groups; lights closer than T share one.

    Returns:
        (n, 3): the mean of each group's pixels, x and y (px), and its area (px), in scan order.

    Raises:
        GroupingError: more than 5 % of the frame is bright, or there are more than `MAX_CLUSTERS`.
    """
    if not count_bright(mask):
        return np.empty((0, 3))
    reach = min(grouping_distance, max(mask.shape))
    # Column after column, as the scan goes: the search for the next seed is one over bytes. With
    # a dark edge all groups' windows are of one size.
    ones = cv2.transpose(cv2.threshold(mask, 0, 1, cv2.THRESH_BINARY)[1])
    framed = cv2.copyMakeBorder(ones, 0, reach, reach, reach, cv2.BORDER_CONSTANT, value=0)
    bright = bytearray(framed)
    height = framed.shape[1]
    left = np.frombuffer(bright, np.uint8).reshape(-1, height)
    seeds: list[int] = []
    groups: list[bytes] = []
    seed = bright.find(1)
    while seed >= 0:
        if len(seeds) == MAX_CLUSTERS:
            raise GroupingError(f'more than {MAX_CLUSTERS} clusters above the threshold')
        column, row = divmod(seed, height)
        group = left[column : column + reach + 1, row - reach : row + reach + 1]
        seeds.append(seed)
        groups.append(group.tobytes())
        group.fill(0)
        seed = bright.find(1, seed)
    pixels = np.frombuffer(b''.join(groups), np.uint8).reshape(len(groups), -1)
    powers = _powers(reach)
    area, across, down = pixels.astype(powers.dtype).dot(powers).astype(np.float64).T
    columns, rows = np.divmod(seeds, height)
    # The sums are whole numbers, so that the means are exactly those of the pixels.
    x, y = (columns * area + across) / area, ((rows - 2 * reach) * area + down) / area
    return np.stack((x, y, area), axis=-1)


@lru_cache(maxsize=8)
def _powers(reach: int) -> NDArray[np.floating]:
    """(pixels, 3): 1, x, y in a group's window, px; of a type that holds any sum exactly."""
    x, y = np.indices((reach + 1, 2 * reach + 1)).reshape(2, -1)
    powers = np.stack((np.ones(len(x)), x, y), axis=-1)
    return powers.astype(np.float32 if powers.sum(axis=0).max() < 2**24 else np.float64)


def label_five(clusters: Sequence[Cluster]) -> tuple[int, int, int, int, int]:
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


DARK_EDGE = 4.0  # px around a light that belong to its window
DOUBTFUL_AREA = 0.5
"""A sixth cluster larger than this part of the fifth could be a marker just as well."""


def find_clusters(image: Image, parameters: MarkerTrackerParameters) -> list[Cluster]:
    """Every cluster of the frame within the area limits, in scan order.

    Raises:
        GroupingError: the frame is too bright or too noisy to hold markers.
    """
    return [Cluster(x, y, int(area)) for x, y, area in find_lights(image, parameters).tolist()]


def find_lights(image: Image, parameters: MarkerTrackerParameters) -> Array:
    """The same as an array, (n, 3): x and y (px), area (px)."""
    gray = image.gray()
    if parameters.by_components:
        spots = sorted(Blobs(gray, parameters).measure())
        return np.array([spot[:3] for spot in spots], np.float64).reshape(-1, 3)
    groups = group_mask(threshold(gray, parameters.threshold), parameters.grouping_distance)
    lights: Array = groups[area_fits(groups[:, 2], parameters)]
    if not parameters.weighted or not 0 < len(lights) <= MAX_BLOBS:
        return lights
    x, y, area = lights.T
    reach = np.sqrt(area / math.pi) + DARK_EDGE
    meter = CentroidMeter(gray, parameters.threshold, weighted=True)
    windows = meter.windows(*np.round((x - reach, x + reach, y - reach, y + reach)))
    alone = meter.measure_alone(windows, area.tolist())
    # A light with others around it keeps its binary centroid.
    rows = [spot[:3] if spot else row for spot, row in zip(alone, lights.tolist(), strict=True)]
    return np.array(rows, np.float64)


def detect(image: Image, parameters: MarkerTrackerParameters) -> MarkerResult:
    """Find and label the five markers in a whole frame (Appendix A).

    The thesis's program takes the first five groups of the scan, so that one hot pixel at the left
    pushes the right wing out; here the five of greatest area are taken. All are lost where there
    are fewer groups, and where the sixth largest is too much like the fifth.
    """
    try:
        clusters = find_clusters(image, parameters)
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
        detected(label, clusters[index])
        for label, index in zip(TANKER_LABELS, label_five(clusters), strict=True)
    )
    return MarkerResult(markers, roll_of(markers[0], markers[-1]), status)


def detect_any(image: Image, parameters: MarkerTrackerParameters) -> MarkerResult:
    """Find any number of clusters, without names (the purpose of Appendix B)."""
    try:
        clusters = find_clusters(image, parameters)
    except GroupingError as error:
        return MarkerResult((), status=str(error))
    markers = tuple(detected(Label.UNLABELLED, cluster) for cluster in clusters)
    return MarkerResult(markers, status='' if markers else 'no cluster in view')


def detected(label: int, cluster: Cluster) -> Marker:
    """A cluster as a marker that does not move."""
    return Marker(label, MarkerState.DETECTED, cluster.x, cluster.y, area=cluster.area)

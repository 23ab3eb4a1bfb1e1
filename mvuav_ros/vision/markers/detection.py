"""Markers in a whole frame: threshold, grouping, labels (Appendices A and B)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.centroid import clipped, measure_windows
from mvuav_ros.vision.markers.grouping import (
    GroupingError,
    area_fits,
    group_mask,
    label_five,
    roll_of,
)
from mvuav_ros.vision.markers.lights import MAX_BLOBS, Blobs
from mvuav_ros.vision.markers.results import (
    LOST_TANKER,
    TANKER_LABELS,
    Cluster,
    Label,
    Marker,
    MarkerResult,
    MarkerState,
)
from mvuav_ros.vision.point_operations import Pixels, threshold

Array = NDArray[np.float64]

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
        lights = Blobs(gray, parameters).measure_all(parameters.threshold, parameters.weighted)
        return np.asarray(lights[np.lexsort((lights[:, 1], lights[:, 0]))])
    lights = group_mask(threshold(gray, parameters.threshold), parameters.grouping_distance)
    lights = lights[area_fits(lights[:, 2], parameters)]
    return weigh(gray, lights, parameters.threshold) if parameters.weighted else lights


def weigh(gray: Pixels, lights: Array, level: float) -> Array:
    """The lights (n, 3) of x, y and area (px) at their places by intensity.

    A light with others around it keeps its binary centroid, and so do all of them where they
    are too many to be looked at one by one. The level is a fraction of full scale.
    """
    if not 0 < len(lights) <= MAX_BLOBS:
        return lights
    x, y, area = lights.T
    reach = np.sqrt(area / math.pi) + DARK_EDGE
    bounds = np.round((x - reach, x + reach, y - reach, y + reach))
    measured = measure_windows(gray, clipped(bounds, gray), level, weighted=True)
    return np.where((measured[:, 2] == area)[:, None], measured, lights)


def detect(image: Image, parameters: MarkerTrackerParameters) -> MarkerResult:
    """Find and label the five markers in a whole frame (Appendix A).

    The thesis's program takes the first five groups of the scan, so that one hot pixel at the
    left pushes the right wing out; here the five of greatest area are taken. With exactly five
    groups the two are the same. All five are lost where labels cannot be known: with fewer
    groups, and where the sixth largest is too much like the fifth.
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
    """Find any number of clusters, without names (the purpose of Appendix B).

    The thesis's program works for five or six markers and loops forever when two clusters
    interleave in the scan; this one ends on every input.
    """
    try:
        clusters = find_clusters(image, parameters)
    except GroupingError as error:
        return MarkerResult((), status=str(error))
    markers = tuple(detected(Label.UNLABELLED, cluster) for cluster in clusters)
    return MarkerResult(markers, status='' if markers else 'no cluster in view')


def detected(label: int, cluster: Cluster) -> Marker:
    """A cluster as a marker that does not move."""
    return Marker(label, MarkerState.DETECTED, cluster.x, cluster.y, area=cluster.area)

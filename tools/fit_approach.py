"""Fits the log odds of mode approach to footage (probability.json).

Not part of the package: it needs the footage, which is not given away, and takes minutes. Only
the tuning half is used: the flights of run 3 and of run 5, the cockpit stills of every other
video, two roads and the part of the UAV clip without a runway; in colour and in grey. Run 2, the
other stills and the motorway are left for checks. The weights of strips seen from near by are
fitted to the same flights, stills, roads and fields, also cut off below their horizons or
magnified, to simulated flights near a runway, over it, and looking down at it, and to single views
of simulated runways (`approach_glimpses`). The others of the cut flights have the same weights as
those with a horizon. Every image counts twice: as it is, and with text drawn into it
(`approach_text`); of every still and flight there are images with text and no runway, too.

    python tools/fit_approach.py ../shared/footage [--near-by]
"""

from __future__ import annotations

import csv
import itertools
import json
import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from approach_drone import UAV_RUNWAY
from approach_flights import (
    FLIGHTS,
    LOOKING_DOWN,
    OVERFLOWN,
    TUNED_SEEDS,
    flight_of,
    frames_between,
    label_of,
    looking_down_settings,
    overflown_settings,
    slope_of,
)
from approach_glimpses import Glimpses, GlimpsesBefore, glimpses, road_views
from approach_text import burned_in
from approach_views import Shot, following, magnified, painted_over, without_runway
from numpy.typing import NDArray
from scipy.optimize import minimize

from mvuav_ros.offline.evaluation.corners import LabelledFrame, read_corners, read_horizon
from mvuav_ros.vision.approach.appearance import FEATURES
from mvuav_ros.vision.approach.attitude import Derotation
from mvuav_ros.vision.approach.evidence import shrink_levels
from mvuav_ros.vision.approach.probability import standardised
from mvuav_ros.vision.approach.search import Candidates, LevelledImage, _fan, find_candidates
from mvuav_ros.vision.approach.tuning import SEARCH, TRACK

OUTPUT = Path('mvuav_ros/vision/approach/probability.json')
UNITS, STARTS = 24, 3
"""Of the hidden layer, in each of so many fits. Without it images that were left out of the fit
have a mean loss of 0.76 instead of 0.59 ahead, and 0.36 instead of 0.17 from near by; with 8 units
0.65 and 0.24. One fit alone finds more where there is no runway."""
SLOPE_PENALTY = 40.0
"""Of squared slopes of the linear part."""
AHEAD_PENALTY, NEAR_BY_PENALTY = 3.0, 10.0
"""Of squared weights of the hidden layer, ten times as much of those outward. With less from near
by, images without a runway that were left out fit worse."""
MAX_ITERATIONS = 400
RUN_WEIGHT = 0.4
"""Of an image of run 3, of which there are many, beside any other image."""
OVERFLOWN_WEIGHT, STEEP_WEIGHT = 0.4, 0.8
"""The same, from near by: of a frame of a simulated flight over or before a runway, and of one that
looks down at it."""
SIMULATED_WEIGHT = 0.4
"""Of a view of a simulated runway that is ahead."""
MAGNIFIED_WEIGHT = 2.0
"""Of a magnified frame of run 3 or 5."""
ROAD_WEIGHT, CUT_WEIGHT = 20.0, 4.0
"""Likewise of one without a runway: as it is, and cut off below its horizon."""
GLIMPSES = (
    (range(400, 560), Glimpses, 1.6),
    (range(600, 760), GlimpsesBefore, 0.8),
    (range(760, 920), Glimpses, 0.8),
)
"""Seeds of runways, the kind of single views that show them, and what one counts."""
ROAD_GLIMPSES, ROAD_GLIMPSE_WEIGHT = range(920, 960), 3.0
"""The same of strips that are roads, as they are seen from a car."""
STEEP_SEEDS = range(140, 150)
"""More seeds of shaken flights that look down steeply: little of both edges is in view at a time,
so that a few flights do not stand for others."""
MIN_BESIDE = 4.0
"""Tolerances of an error: what is nearer is no wrong strip where a runway's right one is missing.
Half a runway, from an edge to the centreline, is farther off."""
WIDER = {'widest': 5.0, 'steepest': 4.0}
"""Of `SEARCH`, for roads."""
_SEEDS = itertools.count(1)


_GLIMPSE_SEEDS = itertools.count(56000)


def with_text(image: NDArray[Any], seeds: Iterator[int] = _SEEDS) -> NDArray[Any]:
    """A copy with text that no other image has."""
    return burned_in(image, next(seeds))


def plain_and_with_text(
    image: NDArray[Any], seeds: Iterator[int] = _SEEDS
) -> tuple[NDArray[Any], NDArray[Any]]:
    """An image as it is, and with text."""
    return image, with_text(image, seeds)


class Example(NamedTuple):
    """The candidates of one image.

    Attributes:
        features: (n, features).
        right: (n,) whether each is the runway; those between right and wrong are left out.
        weight: of the image.
        text: it was drawn into the image.
    """

    features: NDArray[np.float64]
    right: NDArray[np.bool_]
    weight: float
    text: bool


class Allowed(NamedTuple):
    """Error of a right strip: px, and share of the near width."""

    least: float
    share: float


USUAL = Allowed(3.0, 0.05)
NEAR_BY = Allowed(12.0, 0.1)
"""Of simulated runways from near by: they are found on coarse images, and their edges are placed
on finer ones afterwards."""


def examples(footage: Path) -> Iterator[Example]:
    """All images of the tuning half."""
    yield from of_stills(footage / 'runway' / 'cockpit_stills')
    run3, run5 = (footage / 'runway' / f'approach_run{number}' for number in (3, 5))
    yield from of_run(run3, 10, Allowed(3.0, 0.05), RUN_WEIGHT)
    yield from of_run(run5, 20, Allowed(4.0, 0.08), 1.0)
    yield from of_cut_runs(footage, near_by=False)
    for clip, step in (
        ('road/straight_rural_road_720p50.mp4', 30),
        ('road/forest_road_white_edges.mp4', 30),
        ('runway/uav_a4_over_threshold_640x480.mp4', 25),
    ):
        yield from of_clip(footage / clip, step)


def examples_near_by(footage: Path) -> Iterator[Example]:
    """Images of the tuning half, of whose candidates those seen from near by are taken."""
    yield from of_cut_runs(footage, near_by=True)
    yield from of_magnified_runs(footage)
    yield from of_flights()
    yield from of_glimpses()
    yield from of_roads(near_by=True)
    for run, step, allowed in (('run3', 12, Allowed(3.0, 0.05)), ('run5', 16, Allowed(4.0, 0.08))):
        folder = footage / 'runway' / f'approach_{run}'
        for number, label in enumerate(read_corners(folder / 'corners.csv')[::step]):
            image = both_kinds(cv2.imread(str(folder / label.file)))[number % 2]
            for text, seen in enumerate(plain_and_with_text(image)):
                yield near_or_far(seen, label, allowed, text=bool(text))
    for number, path in enumerate(tuned_stills(footage / 'runway' / 'cockpit_stills')):
        yield near_or_far(both_kinds(cv2.imread(str(path)))[number % 2], None)
    for clip, step, horizon in (
        ('road/straight_rural_road_720p50.mp4', 4, 0.5),
        ('road/forest_road_white_edges.mp4', 6, 0.5),
        ('runway/uav_a4_over_threshold_640x480.mp4', 16, 0.6),
    ):
        for number, image in enumerate(frames_without_runway(footage / clip, step)):
            cut = np.ascontiguousarray(image[int(horizon * image.shape[0]) :])
            # Without the horizon in every fourth.
            for top, seen in enumerate((image, cut) if number % 4 == 0 else (image,)):
                for text, drawn in enumerate(plain_and_with_text(seen)):
                    found = near_or_far(drawn, None, text=bool(text))
                    yield found._replace(weight=CUT_WEIGHT if top else ROAD_WEIGHT)


def of_flights() -> Iterator[Example]:
    """Simulated flights of the tuning half: near a runway, over it, and looking down at it."""
    for name, settings, (first, last) in near_flights():
        flight = flight_of(name, settings)
        weight = STEEP_WEIGHT if name in LOOKING_DOWN else OVERFLOWN_WEIGHT
        frames = frames_between(flight, first, last, 12)
        for number, index in enumerate(frames):
            truth = flight.truth_at(flight.seen_at(index))
            label = label_of(truth)
            if label is not None:
                image = both_kinds(flight.frame(index).image.pixels)[number % 2]
                found = near_or_far(image, label, NEAR_BY, slope=slope_of(truth))
                yield found._replace(weight=weight)


def near_flights() -> Iterator[tuple[str, dict[str, Any], tuple[float, float]]]:
    """Name and settings of simulated flights, and from where to where, m behind the near end."""
    for name in LOOKING_DOWN:
        more = STEEP_SEEDS if 'shaken' in name else ()
        for seed in (*TUNED_SEEDS, *more):
            yield name, looking_down_settings(name, seed), (-80.0, 200.0)
    for name, settings in OVERFLOWN.items():
        for seed in TUNED_SEEDS:
            yield name, overflown_settings(name, seed), (20.0, settings['runway_length'] - 60.0)
    for name in ('approach', 'low pass', '15 m aside', 'shaken'):
        yield name, FLIGHTS[name], (-160.0, 0.0)


def of_cut_runs(footage: Path, *, near_by: bool) -> Iterator[Example]:
    """Frames of the labelled approaches, cut off below their horizons."""
    runs = (
        ('approach_run3', 200, 6, Allowed(3.0, 0.05)),
        ('approach_run5', 200, 8, Allowed(4, 0.08)),
    )
    for run, first, step, allowed in runs:
        folder = footage / 'runway' / run
        labels = read_corners(folder / 'corners.csv')
        frames = list(zip(labels, read_horizon(folder / 'horizon.csv', labels), strict=True))
        for index in range(first, len(frames), step):
            label, line = frames[index]
            colour = cv2.imread(str(folder / label.file))
            number = index // step
            view = following((2.0, 8.0, 14.0, 20.0, 30.0)[number % 5], (1, 2, 3)[number % 3])
            shot = view(Shot(both_kinds(colour)[number % 2], label, line), index)
            if shot.label is not None and shot.label.near_left[1] > 12:
                for text, seen in enumerate(plain_and_with_text(shot.image)):
                    yield near_or_far(seen, shot.label, allowed, text=bool(text), near_by=near_by)


def of_magnified_runs(footage: Path) -> Iterator[Example]:
    """Frames of the labelled approaches, magnified, if the near end is then out of view."""
    for run, zoom, step, allowed in (
        ('approach_run3', 2, 1, Allowed(6.0, 0.05)),
        ('approach_run3', 3, 2, Allowed(9.0, 0.05)),
        ('approach_run3', 4, 4, Allowed(12.0, 0.05)),
        ('approach_run5', 4, 10, Allowed(16.0, 0.08)),
    ):
        folder = footage / 'runway' / run
        labels = read_corners(folder / 'corners.csv')
        frames = list(zip(labels, read_horizon(folder / 'horizon.csv', labels), strict=True))
        for number, (label, line) in enumerate(frames[::step]):
            colour = cv2.imread(str(folder / label.file))
            shot = magnified(zoom)(Shot(both_kinds(colour)[number % 2], label, line), number)
            if shot.label is not None:
                for text, seen in enumerate(plain_and_with_text(shot.image)):
                    at = line.slope
                    found = near_or_far(seen, shot.label, allowed, text=bool(text), slope=at)
                    yield found._replace(weight=MAGNIFIED_WEIGHT)


def of_glimpses() -> Iterator[Example]:
    """Single views of simulated runways, colour and grey by turns."""
    for number, (seeds, kind, weight) in enumerate(GLIMPSES):
        texts = _GLIMPSE_SEEDS if number else _SEEDS
        for index, (colour, label, slope) in enumerate(glimpses(seeds, 4, kind)):
            image = both_kinds(colour)[index % 2]
            for text, seen in enumerate(plain_and_with_text(image, texts)):
                found = near_or_far(seen, label, NEAR_BY, text=bool(text), slope=slope)
                yield found._replace(weight=weight)


def of_roads(*, near_by: bool = False) -> Iterator[Example]:
    """Views of simulated roads as from a car; of all candidates, or of those from near by alone."""
    texts, parts = itertools.count(58000), []
    with wider_search():
        for index, (colour, slope) in enumerate(road_views(ROAD_GLIMPSES, 4)):
            image = both_kinds(colour)[index % 2]
            for number, seen in enumerate(plain_and_with_text(image, texts)):
                parts.append((anywhere(seen, slope)[0], bool(number)))
    for found, text in parts:
        used = is_near_by(found) if near_by else slice(None)
        part = Candidates(found.strips[used], found.features[used])
        yield without(part, ROAD_GLIMPSE_WEIGHT, text=text)


@contextmanager
def wider_search() -> Iterator[None]:
    """Search strips as wide as a track may become, beyond what is searched otherwise."""
    usual = {name: getattr(SEARCH, name) for name in WIDER}
    try:
        _set_search(WIDER)
        yield
    finally:
        _set_search(usual)


def _set_search(values: dict[str, float]) -> None:
    for name, value in values.items():
        # The constants are frozen.
        object.__setattr__(SEARCH, name, value)
    _fan.cache_clear()


def of_simulated_ahead() -> Iterator[Example]:
    """Views of simulated runways from before the near end, in which a strip ahead is the runway."""
    for number, (colour, label, slope) in enumerate(simulated_views()):
        image = both_kinds(colour)[number % 2]
        for text, seen in enumerate(plain_and_with_text(image, _GLIMPSE_SEEDS)):
            found, level = anywhere(seen, slope)
            error = errors(found.strips, label, level, USUAL)
            right = error <= 1
            if (right & ~is_near_by(found)).any():
                clear = right | (error > 1.4)
                yield chosen(found, right, clear, SIMULATED_WEIGHT, text=bool(text))


def simulated_views() -> Iterator[tuple[NDArray[Any], LabelledFrame, float]]:
    """Image, corners and slope of the horizon: single views, and frames of the tuned approaches."""
    (seeds,) = (seeds for seeds, kind, _ in GLIMPSES if kind is GlimpsesBefore)
    yield from glimpses(seeds, 4, GlimpsesBefore)
    for name, settings in FLIGHTS.items():
        flight = flight_of(name, settings)
        distance = flight.settings.start_distance
        for index in frames_between(flight, -distance, -160.0, 20):
            truth = flight.truth_at(flight.seen_at(index))
            label = label_of(truth)
            if label is not None:
                yield flight.frame(index).image.pixels, label, slope_of(truth)


def anywhere(image: NDArray[Any], slope: float) -> tuple[Candidates, Derotation]:
    """Candidates everywhere in an image and above it, and how it was levelled by a slope, rad."""
    pixels, factor = shrink_levels(image)
    height, columns = pixels.shape[:2]
    level = Derotation(columns, height, factor, slope)
    whole = LevelledImage(pixels, level)
    return find_candidates(whole, (-0.45 * height, 0.65 * height)), level


def is_near_by(found: Candidates) -> NDArray[np.bool_]:
    """Which candidates are seen from near by."""
    return found.features[:, FEATURES.index('depth')] > TRACK.min_near_by


def near_or_far(
    image: NDArray[Any],
    label: LabelledFrame | None,
    allowed: Allowed = USUAL,
    *,
    text: bool = False,
    near_by: bool = True,
    slope: float = 0.0,
) -> Example:
    """The candidates seen from near by, or the others; the image is levelled by a slope, rad."""
    found, level = anywhere(image, slope)
    used = is_near_by(found) == near_by
    found = Candidates(found.strips[used], found.features[used])
    if label is None:
        return without(found, 1.0, text=text)
    error = errors(found.strips, label, level, allowed)
    beside = error > (2.0 if (error <= 1).any() else MIN_BESIDE)
    return chosen(found, error <= 1, (error <= 1) | beside, 1.0, text=text)


def both_kinds(image: NDArray[Any]) -> list[NDArray[Any]]:
    """In colour and in grey."""
    return [image, np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))]


def of_stills(folder: Path) -> Iterator[Example]:
    """Stills of the videos whose number over two is even; right is an overlap of 0.3."""
    boxes: dict[str, list[list[float]]] = {}
    with (folder / 'boxes.csv').open(newline='') as file:
        for row in csv.DictReader(file):
            box = [float(row[name]) for name in ('x_min', 'y_min', 'x_max', 'y_max')]
            boxes.setdefault(row['file'], []).append(box)
    for path in tuned_stills(folder):
        name = path.name
        for image in both_kinds(cv2.imread(str(path))):
            for text, seen in enumerate(plain_and_with_text(image)):
                found, factor = whole(seen)
                corners = (corners_of(found.strips) + 0.5) * factor - 0.5
                overlaps = np.max([overlap(corners, box) for box in boxes[name]], axis=0)
                clear = (overlaps >= 0.3) | (overlaps < 0.1)
                yield chosen(found, overlaps >= 0.3, clear, 1.0, text=bool(text))
            bare = painted_over(image, [((x, y), (x2, y2)) for x, y, x2, y2 in boxes[name]])
            yield without(whole(with_text(bare))[0], 1.0, text=True)


def tuned_stills(folder: Path) -> list[Path]:
    """Those of the videos whose number over two is even."""
    return [
        path for path in sorted(folder.glob('*.jpg')) if not int(path.name.split('-')[1]) // 2 % 2
    ]


def of_run(folder: Path, step: int, allowed: Allowed, weight: float) -> Iterator[Example]:
    """Frames of a labelled approach; right is an error within the tolerance."""
    labels = read_corners(folder / 'corners.csv')
    lines = read_horizon(folder / 'horizon.csv', labels)
    for number, (label, line) in enumerate(list(zip(labels, lines, strict=True))[::step]):
        colour = cv2.imread(str(folder / label.file))
        gray_camera = folder.name == 'approach_run5'
        for image in both_kinds(colour)[1 if gray_camera else 0 :]:
            level = Derotation(image.shape[1], image.shape[0], 1, line.slope)
            middle = level.row_of(line.row)

            def candidates(
                seen: NDArray[Any], level: Derotation = level, middle: float = middle
            ) -> Candidates:
                return find_candidates(
                    LevelledImage(level.turned(seen)), (middle - 20, middle + 50)
                )

            for text, seen in enumerate(plain_and_with_text(image)):
                found = candidates(seen)
                error = errors(found.strips, label, level, allowed)
                clear = (error <= 1) | (error > 1.4)
                yield chosen(found, error <= 1, clear, weight, text=bool(text))
            if number % 2:
                bare = without_runway(Shot(image, label, line), 0).image
                yield without(candidates(with_text(bare)), weight, text=True)


def of_clip(path: Path, step: int) -> Iterator[Example]:
    """Frames without a runway, colour and grey by turns."""
    for image in frames_without_runway(path, step):
        for text, seen in enumerate(plain_and_with_text(image)):
            yield without(whole(seen)[0], 1.0, text=bool(text))


def frames_without_runway(path: Path, step: int) -> Iterator[NDArray[Any]]:
    """Every so many frames of a clip, colour and grey by turns."""
    clip, index = cv2.VideoCapture(str(path)), 0
    while clip.grab():
        if index % step == 0 and not ('uav' in path.name and index in UAV_RUNWAY):
            yield both_kinds(np.asarray(clip.retrieve()[1]))[index // step % 2]
        index += 1


def whole(image: NDArray[Any]) -> tuple[Candidates, int]:
    """Candidates everywhere in an image, and px of the image per px of them."""
    pixels, factor = shrink_levels(image)
    height = pixels.shape[0]
    return find_candidates(LevelledImage(pixels), (0.03 * height, 0.65 * height)), factor


def chosen(
    found: Candidates,
    right: NDArray[np.bool_],
    clear: NDArray[np.bool_],
    weight: float,
    *,
    text: bool,
) -> Example:
    """Without the candidates that are neither right nor wrong."""
    return Example(found.features[clear], right[clear], weight, text)


def without(found: Candidates, weight: float, *, text: bool) -> Example:
    """Of an image without a runway."""
    return Example(found.features, np.zeros(len(found.strips), bool), weight, text)


def corners_of(strips: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 4, 2) near left, near right, far right, far left."""
    x, y, left, right, far, near = strips.T
    ends = ((left, near), (right, near), (right, far), (left, far))
    return np.stack([np.stack([x + s * d, y + d], axis=-1) for s, d in ends], axis=1)


def overlap(corners: NDArray[np.float64], box: list[float]) -> NDArray[np.float64]:
    """Intersection over union of the bounding boxes of n strips with a box."""
    first, last = corners.min(axis=1), corners.max(axis=1)
    inner = np.minimum(last, box[2:]) - np.maximum(first, box[:2])
    shared = np.prod(np.maximum(inner, 0), axis=1)
    area = (box[2] - box[0]) * (box[3] - box[1])
    result: NDArray[np.float64] = shared / (np.prod(last - first, axis=1) + area - shared)
    return result


def errors(
    strips: NDArray[np.float64], label: LabelledFrame, level: Derotation, allowed: Allowed
) -> NDArray[np.float64]:
    """(n,) largest horizontal error at the four corners, in tolerances."""
    worst = np.zeros(len(strips))
    cos, sin = math.cos(level.slope), math.sin(level.slope)
    for side, ends in (
        (2, (label.near_left, label.far_left)),
        (3, (label.near_right, label.far_right)),
    ):
        for on_x, on_y in ends:
            dx = (on_x + 0.5) / level.factor - 0.5 - level.centre[0]
            dy = (on_y + 0.5) / level.factor - 0.5 - level.centre[1]
            x, y = level.centre[0] + cos * dx + sin * dy, level.centre[1] - sin * dx + cos * dy
            at = strips[:, 0] + strips[:, side] * (y - strips[:, 1])
            worst = np.maximum(worst, np.abs(at - x))
    width = abs(label.near_right[0] - label.near_left[0]) / level.factor
    return worst / max(allowed.least, allowed.share * width)


def odds(images: list[Example]) -> float:
    """Of an image with a runway."""
    found = sum(image.weight for image in images if image.right.any())
    return found / (sum(image.weight for image in images) - found)


def fit(images: list[Example], usual: float, penalty: float) -> dict[str, Any]:
    """Maximise the probability that of each image's candidates a right one, or none, is chosen.

    The offset is that of images in which a runway has the usual odds. Of several fits from other
    weights to begin with the log odds are averaged.
    """
    features = np.concatenate([image.features for image in images])
    seen = np.ma.masked_invalid(features)
    mean, deviation = seen.mean(axis=0).filled(0.0), seen.std(axis=0).filled(0.0)
    # A feature that no image shows, or all show alike, says nothing.
    deviation[deviation < 1e-4] = 1.0
    problem = Problem(standardised(features, mean, deviation), images, penalty)
    fits = [problem.solve(number) for number in range(STARTS)]
    offset, slopes, inward, bias, outward = zip(*fits, strict=True)
    fitted = {
        'mean': mean,
        'deviation': deviation,
        'slopes': np.mean(slopes, axis=0),
        'inward': np.concatenate(inward, axis=1),
        'bias': np.concatenate(bias),
        'outward': np.concatenate(outward) / STARTS,
        'offset': np.mean(offset) + math.log(usual / odds(images)),
    }
    return {name: np.round(array, 5).tolist() for name, array in fitted.items()}


class Problem:
    """The likelihood of a choice among each image's candidates and none.

    The values are (candidates, features), those of all images, as `EvidenceWeights` takes them; the
    penalty is of squared weights of the hidden layer.
    """

    def __init__(self, values: NDArray[np.float64], images: list[Example], penalty: float) -> None:
        counts = [len(image.features) for image in images]
        # Single precision takes half the time.
        self._values = values.astype(np.float32)
        self._first = np.cumsum([0, *counts[:-1]])
        self._image = np.repeat(np.arange(len(images)), counts)
        self._right = np.concatenate([image.right for image in images]).astype(float)
        self._any = np.array([image.right.any() for image in images])
        self._weight = np.array([image.weight for image in images])
        count = values.shape[1]
        self._sizes = 1, count, count * UNITS, UNITS, UNITS
        costs = 0.0, SLOPE_PENALTY, penalty, 0.0, 10.0 * penalty
        self._costs = np.repeat(costs, self._sizes)

    def solve(self, number: int) -> tuple[Any, ...]:
        """The parts of the weights that fit, from a start with a number."""
        spread = np.repeat((0.0, 0.0, 0.3, 0.3, 0.1), self._sizes)
        start = np.random.default_rng(number).normal(0.0, spread)
        start[0] = -3.0
        options = {'maxiter': MAX_ITERATIONS}
        found = minimize(self._loss, start, jac=True, method='L-BFGS-B', options=options)
        return self._parts(found.x)

    def _parts(self, weights: NDArray[np.float64]) -> tuple[Any, ...]:
        """Offset, slopes, and the hidden layer's weights inward, biases and weights outward."""
        offset, slopes, inward, bias, outward = np.split(weights, np.cumsum(self._sizes)[:-1])
        return offset[0], slopes, inward.reshape(-1, UNITS), bias, outward

    def _loss(self, weights: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Negative logarithm with the penalty, and its gradient."""
        offset, slopes, inward, bias, outward = self._parts(weights.astype(np.float32))
        hidden = np.tanh(self._values @ inward + bias)
        odds = (self._values @ slopes + hidden @ outward).astype(float) + float(offset)
        most = np.maximum(np.maximum.reduceat(odds, self._first), 0.0)
        chance, none = np.exp(odds - most[self._image]), np.exp(-most)
        total = np.add.reduceat(chance, self._first) + none
        good = np.where(self._any, np.add.reduceat(chance * self._right, self._first), none)
        good = np.maximum(good, 1e-30)
        value = float((self._weight * (np.log(total) - np.log(good))).sum())
        share = np.where(self._any[self._image], chance * self._right / good[self._image], 0.0)
        by_odds = self._weight[self._image] * (chance / total[self._image] - share)
        single = by_odds.astype(np.float32)
        by_hidden = single[:, None] * outward * (1.0 - hidden * hidden)
        gradient = (
            [by_odds.sum()],
            self._values.T @ single,
            (self._values.T @ by_hidden).ravel(),
            by_hidden.sum(axis=0),
            hidden.T @ single,
        )
        squares = 0.5 * float((self._costs * weights**2).sum())
        return value + squares, np.concatenate(gradient) + self._costs * weights


def main() -> None:
    """Fit and write."""
    cv2.setNumThreads(1)
    fitted = json.loads(OUTPUT.read_text())
    near_by = '--near-by' in sys.argv
    footage = Path(sys.argv[1])
    images = [i for i in (examples_near_by if near_by else examples)(footage) if len(i.features)]
    usual = odds([image for image in images if not image.text])
    if near_by:
        fitted['near_by'] = fit(images, usual, NEAR_BY_PENALTY)
    else:
        images += [*of_simulated_ahead(), *(i for i in of_roads() if len(i.features))]
        fitted['ahead'] = fit(images, usual, AHEAD_PENALTY)
    fitted['features'] = list(FEATURES)
    OUTPUT.write_text(json.dumps(fitted) + '\n')
    found = sum(bool(image.right.any()) for image in images)
    print(f'{OUTPUT}: fitted to {len(images)} images, {found} with a runway found')


if __name__ == '__main__':
    main()

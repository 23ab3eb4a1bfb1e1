"""Fits the log odds of mode approach to footage (probability.json).

Not part of the package: it needs the footage, which is not given away, and takes minutes. Only
the tuning half is used: the flights of run 3 and of run 5, the cockpit stills of every other
video, two roads and the part of the UAV clip without a runway; in colour and in grey. Run 2, the
other stills and the motorway are left for checks. The weights of strips whose edges meet above
the image are fitted to the same flights, roads and fields cut off below their horizons, and to
simulated flights whose camera looks down. Narrow strips of the cut flights have the same weights
as those with a horizon. Every image counts twice: as it is, and with text drawn into it
(`approach_text`); of every still and flight there are images with text and no runway, too.

    python tools/fit_approach.py ../shared/footage [--above]
"""

from __future__ import annotations

import csv
import itertools
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from approach_flights import STEEP, STEEP_CHECK, BankedFlight, SlabFlight
from approach_text import burned_in
from approach_views import Shot, following, painted_over, without_runway
from numpy.typing import NDArray
from scipy.optimize import minimize

from mvuav_ros.offline.evaluation.corners import LabelledFrame, read_corners, read_horizon
from mvuav_ros.simulation.settings import RunwaySettings
from mvuav_ros.vision.approach.appearance import FEATURES
from mvuav_ros.vision.approach.attitude import Derotation, HorizonLine
from mvuav_ros.vision.approach.evidence import shrink_levels
from mvuav_ros.vision.approach.search import Candidates, LevelledImage, find_candidates
from mvuav_ros.vision.approach.tuning import APPEARANCE, PROBABILITY

OUTPUT = Path('mvuav_ros/vision/approach/probability.json')
QUANTILES = (0.2, 0.8)
"""Of the right strips' features: where the slopes of the log odds change."""
PENALTY = 40.0
"""Of squared slopes; 20 fits the tuning half better and the stills left for checks no worse."""
RUN_WEIGHT = 0.4
"""Of an image of run 3, of which there are many, beside any other image."""


_SEEDS = itertools.count(1)


def with_text(image: NDArray[Any]) -> NDArray[Any]:
    """A copy with text that no other image has."""
    return burned_in(image, next(_SEEDS))


def plain_and_with_text(image: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """An image as it is, and with text."""
    return image, with_text(image)


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


def examples_above(footage: Path) -> Iterator[Example]:
    """Images of the tuning half without a horizon, of which strips meet above."""
    yield from of_cut_runs(footage, near_by=True)
    for name, settings in STEEP.items():
        if name in STEEP_CHECK or name.endswith('attitude'):
            continue
        kind = SlabFlight if name.startswith('slabs') else BankedFlight
        flight = kind(RunwaySettings(frames=1000, **settings))
        last = int((flight.settings.start_distance - 20) / flight.settings.speed * 25)
        for number, index in enumerate(range(last - 50, last + 150, 8)):
            lines = flight.truth_at(flight.seen_at(index)).lines
            ends = [p for line in lines[:2] for p in ((line.x2, line.y2), (line.x1, line.y1))]
            if np.isfinite(ends).all():
                image = both_kinds(flight.frame(index).image.pixels)[number % 2]
                corners = ends[0], ends[2], ends[3], ends[1]
                yield without_horizon(
                    image, LabelledFrame('', *corners), Allowed(6.0, 0.05), text=False
                )
    for clip, step, horizon in (
        ('road/straight_rural_road_720p50.mp4', 25, 0.5),
        ('road/forest_road_white_edges.mp4', 25, 0.5),
        ('runway/uav_a4_over_threshold_640x480.mp4', 16, 0.6),
    ):
        video, index = cv2.VideoCapture(str(footage / clip)), 0
        while video.grab():
            if index % step == 0 and not ('uav' in clip and 180 <= index < 450):
                image = video.retrieve()[1]
                image = both_kinds(image)[index // step % 2]
                # Whole, and without the horizon.
                top = 0 if index // step % 3 == 0 else int(horizon * image.shape[0])
                for text, seen in enumerate(plain_and_with_text(np.ascontiguousarray(image[top:]))):
                    yield without_horizon(seen, None, Allowed(3.0, 0.05), text=bool(text))
            index += 1


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
            view = following((2.0, 8.0, 14.0, 20.0)[number % 4], (1, 2, 3)[number % 3])
            shot = view(Shot(both_kinds(colour)[number % 2], label, line), index)
            if shot.label is not None and shot.label.near_left[1] > 12:
                for text, seen in enumerate(plain_and_with_text(shot.image)):
                    yield without_horizon(
                        seen, shot.label, allowed, text=bool(text), near_by=near_by
                    )


def without_horizon(
    image: NDArray[Any],
    label: LabelledFrame | None,
    allowed: Allowed,
    *,
    text: bool,
    near_by: bool = True,
) -> Example:
    """Candidates that meet above an image, or all but the wide ones of them."""
    pixels, factor = shrink_levels(image)
    height = pixels.shape[0]
    found = find_candidates(
        LevelledImage(pixels), -0.45 * height, 0.0 if near_by else 0.65 * height
    )
    used = found.strips[:, 1] < APPEARANCE.min_sky_row
    if not near_by:
        used &= found.features[:, FEATURES.index('width')] > PROBABILITY.min_near_by
        used = ~used
    found = Candidates(found.strips[used], found.features[used])
    if label is None:
        return without(found, 1.0, text=text)
    worst = np.zeros(len(found.strips))
    for side, ends in (
        (2, (label.near_left, label.far_left)),
        (3, (label.near_right, label.far_right)),
    ):
        for on_x, on_y in ends:
            x, y = (on_x + 0.5) / factor - 0.5, (on_y + 0.5) / factor - 0.5
            at = found.strips[:, 0] + found.strips[:, side] * (y - found.strips[:, 1])
            worst = np.maximum(worst, np.abs(at - x))
    width = abs(label.near_right[0] - label.near_left[0]) / factor
    error = worst / max(allowed.least, allowed.share * width)
    return chosen(found, error <= 1, (error <= 1) | (error > 2.0), 1.0, text=text)


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
    for name in sorted(boxes):
        if int(name.split('-')[1]) // 2 % 2:
            continue
        for image in both_kinds(cv2.imread(str(folder / name))):
            for text, seen in enumerate(plain_and_with_text(image)):
                found, factor = whole(seen)
                corners = (corners_of(found.strips) + 0.5) * factor - 0.5
                overlaps = np.max([overlap(corners, box) for box in boxes[name]], axis=0)
                clear = (overlaps >= 0.3) | (overlaps < 0.1)
                yield chosen(found, overlaps >= 0.3, clear, 1.0, text=bool(text))
            bare = painted_over(image, [((x, y), (x2, y2)) for x, y, x2, y2 in boxes[name]])
            yield without(whole(with_text(bare))[0], 1.0, text=True)


def of_run(folder: Path, step: int, allowed: Allowed, weight: float) -> Iterator[Example]:
    """Frames of a labelled approach; right is an error within the tolerance."""
    with (folder / 'corners.csv').open(newline='') as file:
        labels = list(csv.DictReader(file))
    corners = read_corners(folder / 'corners.csv')
    with (folder / 'horizon.csv').open(newline='') as file:
        horizons = list(csv.DictReader(file))
    frames = list(zip(labels, horizons, corners, strict=True))[::step]
    for number, (label, horizon, shape) in enumerate(frames):
        slope, row = math.radians(float(horizon['slope_deg'])), float(horizon['row_at_centre'])
        colour = cv2.imread(str(folder / label['file']))
        gray_camera = folder.name == 'approach_run5'
        for image in both_kinds(colour)[1 if gray_camera else 0 :]:
            level = Derotation(image.shape[1], image.shape[0], 1, slope)
            middle = level.row_of(row)

            def candidates(
                seen: NDArray[Any], level: Derotation = level, middle: float = middle
            ) -> Candidates:
                return find_candidates(LevelledImage(level.turned(seen)), middle - 20, middle + 50)

            for text, seen in enumerate(plain_and_with_text(image)):
                found = candidates(seen)
                error = errors(found.strips, label, level, allowed)
                clear = (error <= 1) | (error > 1.4)
                yield chosen(found, error <= 1, clear, weight, text=bool(text))
            if number % 2:
                bare = without_runway(Shot(image, shape, HorizonLine(row, slope)), 0).image
                yield without(candidates(with_text(bare)), weight, text=True)


def of_clip(path: Path, step: int) -> Iterator[Example]:
    """Frames without a runway, colour and grey by turns."""
    clip = cv2.VideoCapture(str(path))
    index = 0
    while clip.grab():
        if index % step == 0 and not ('uav' in path.name and 180 <= index < 450):
            image = both_kinds(clip.retrieve()[1])[index // step % 2]
            for text, seen in enumerate(plain_and_with_text(image)):
                yield without(whole(seen)[0], 1.0, text=bool(text))
        index += 1


def whole(image: NDArray[Any]) -> tuple[Candidates, int]:
    """Candidates everywhere in an image, and px of the image per px of them."""
    pixels, factor = shrink_levels(image)
    height = pixels.shape[0]
    return find_candidates(LevelledImage(pixels), 0.03 * height, 0.65 * height), factor


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
    strips: NDArray[np.float64], label: dict[str, str], level: Derotation, allowed: Allowed
) -> NDArray[np.float64]:
    """(n,) largest horizontal error at the four corners, in tolerances."""
    worst = np.zeros(len(strips))
    cos, sin = math.cos(level.slope), math.sin(level.slope)
    for corner in ('near_left', 'far_left', 'near_right', 'far_right'):
        dx = float(label[f'{corner}_x']) - level.centre[0]
        dy = float(label[f'{corner}_y']) - level.centre[1]
        x, y = level.centre[0] + cos * dx + sin * dy, level.centre[1] - sin * dx + cos * dy
        slope = strips[:, 2 if 'left' in corner else 3]
        worst = np.maximum(worst, np.abs(strips[:, 0] + slope * (y - strips[:, 1]) - x))
    width = abs(float(label['near_right_x']) - float(label['near_left_x']))
    return worst / max(allowed.least, allowed.share * width)


def odds(images: list[Example]) -> float:
    """Of an image with a runway."""
    found = sum(image.weight for image in images if image.right.any())
    return found / (sum(image.weight for image in images) - found)


def fit(images: list[Example]) -> dict[str, Any]:
    """Maximise the probability that of each image's candidates a right one, or none, is chosen.

    Among images with text runways are rarer than usual: the offset is that of images as they are.
    """
    rarer = odds([image for image in images if not image.text]) / odds(images)
    features = np.concatenate([image.features for image in images])
    seen = np.ma.masked_invalid(features)
    mean, deviation = seen.mean(axis=0).filled(0.0), seen.std(axis=0).filled(0.0)
    # A feature that no image shows says nothing.
    deviation[deviation < 1e-4] = 1.0

    def scaled(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.clip((values - mean) / deviation, -4, 4)

    right = np.concatenate([image.features[image.right] for image in images])
    knots = np.nanquantile(scaled(np.concatenate([right, features[::20]])), QUANTILES, axis=0)
    knots = np.nan_to_num(knots)
    values = scaled(features)
    basis = np.concatenate([values, *(np.maximum(values - knot, 0) for knot in knots)], axis=1)
    # What is not seen does not count.
    basis = np.nan_to_num(basis)
    unit = basis.std(axis=0) + 1e-6
    problem = Problem(basis / unit, images)
    start = np.zeros(basis.shape[1] + 1)
    start[0] = -3.0
    solution = minimize(problem.loss, start, jac=True, method='L-BFGS-B', options={'maxiter': 300})
    slopes = (solution.x[1:] / unit).reshape(len(QUANTILES) + 1, -1)
    return {
        'features': list(FEATURES),
        **{
            name: np.round(array, 5).tolist()
            for name, array in (
                ('mean', mean),
                ('deviation', deviation),
                ('knots', knots),
                ('slopes', slopes),
            )
        },
        'offset': round(float(solution.x[0]) + math.log(rarer), 5),
    }


class Problem:
    """The likelihood of a choice among each image's candidates and none."""

    def __init__(self, basis: NDArray[np.float64], images: list[Example]) -> None:
        counts = [len(image.features) for image in images]
        self._basis = basis
        self._first = np.cumsum([0, *counts[:-1]])
        self._image = np.repeat(np.arange(len(images)), counts)
        self._right = np.concatenate([image.right for image in images]).astype(float)
        self._any = np.array([image.right.any() for image in images])
        self._weight = np.array([image.weight for image in images])

    def loss(self, slopes: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Negative logarithm with the penalty, and its gradient; the offset comes first."""
        odds = self._basis @ slopes[1:] + slopes[0]
        most = np.maximum(np.maximum.reduceat(odds, self._first), 0.0)
        chance, none = np.exp(odds - most[self._image]), np.exp(-most)
        total = np.add.reduceat(chance, self._first) + none
        good = np.where(self._any, np.add.reduceat(chance * self._right, self._first), none)
        good = np.maximum(good, 1e-30)
        penalty = 0.5 * PENALTY * float((slopes[1:] ** 2).sum())
        value = float((self._weight * (np.log(total) - np.log(good))).sum()) + penalty
        share = np.where(self._any[self._image], chance * self._right / good[self._image], 0.0)
        by_odds = self._weight[self._image] * (chance / total[self._image] - share)
        return value, np.concatenate(
            [[by_odds.sum()], self._basis.T @ by_odds + PENALTY * slopes[1:]]
        )


def main() -> None:
    """Fit and write."""
    cv2.setNumThreads(1)
    fitted = json.loads(OUTPUT.read_text())
    which = examples_above if '--above' in sys.argv else examples
    images = [image for image in which(Path(sys.argv[1])) if len(image.features)]
    weights = fit(images)
    if '--above' in sys.argv:
        fitted['above'] = weights
    else:
        fitted |= weights
    OUTPUT.write_text(json.dumps(fitted, indent=1) + '\n')
    found = sum(bool(image.right.any()) for image in images)
    print(f'{OUTPUT}: fitted to {len(images)} images, {found} with a runway found')


if __name__ == '__main__':
    main()

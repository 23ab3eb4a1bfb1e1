"""Any number of lights without names, each followed under a number of its own."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.lights import GroupingError, find_lights
from mvuav_ros.vision.markers.marker_results import Label, Marker, MarkerResult, MarkerState
from mvuav_ros.vision.markers.motion import MotionPredictor

Array = NDArray[np.float64]
Integers = NDArray[np.intp]

IMPOSSIBLE = 1e6  # The cost of a pair that cannot be, and a distance beyond all others (px)
MAX_CHOICES = 8  # Detections, the nearest, that a known light is held against
_JUMPS_TRIED = 5


def nearest_other(places: Array) -> Array:
    """The distance from each of (n, 2) places to the nearest other one, px; far if alone."""
    if len(places) < 2:
        return np.full(len(places), IMPOSSIBLE)
    return np.asarray(cKDTree(places).query(places, k=2)[0][:, 1])


def choices(predicted: Array, seen: Array, widest: float) -> tuple[Array, Integers]:
    """Distances (n, k) of detections (m, 2) near lights (n, 2), px, infinite beyond the widest.

    And the detections' numbers (n, k), at most `MAX_CHOICES`.
    """
    count = np.arange(1, min(MAX_CHOICES, len(seen)) + 1)
    apart, number = cKDTree(seen).query(predicted, k=count, distance_upper_bound=widest)
    return apart, np.minimum(number, len(seen) - 1)


def assign(cost: Array, number: Integers) -> Integers:
    """Give detections to known lights so that most have one, and the sum of costs is least.

    The cost (n, k) of each light's choices is `IMPOSSIBLE` where they cannot be a pair; the numbers
    (n, k) are the detections'. Returns each light's detection, (n,), or -1.
    """
    light, choice = np.nonzero(cost < IMPOSSIBLE)
    dense = np.full((len(cost), int(number.max()) + 1), IMPOSSIBLE)
    dense[light, number[light, choice]] = cost[light, choice]
    # By the Hungarian method.
    chosen, taken = linear_sum_assignment(dense)
    given = np.full(len(cost), -1)
    given[chosen] = np.where(dense[chosen, taken] < IMPOSSIBLE, taken, -1)
    return given


def common_shift(
    predicted: Array, seen: Array, nearest: Array, longest: float, tolerance: float
) -> Array | None:
    """A jump (2,) that most lights made together, as by a push to the camera; None for none.

    The shifts from every prediction (n, 2) to every detection (m, 2) vote in cells; the fullest are
    tried. The nearest detection of each is (n,) px away, a jump is so long at most, and lights that
    jump together differ by no more than the tolerance, px.
    """
    count = len(predicted)
    at_rest = int((nearest < tolerance).sum())
    if count < 3 or len(seen) < 3 or at_rest > count - 2:
        return None
    shifts = (seen[None] - predicted[:, None]).reshape(-1, 2)
    shifts = shifts[np.abs(shifts).max(axis=1) < longest]
    if len(shifts) < 3:
        return None
    side = int(2 * longest / tolerance) + 2
    cells = np.floor((shifts + longest) / tolerance).astype(np.intp)
    votes = np.bincount(cells[:, 0] * side + cells[:, 1], minlength=side * side).reshape(side, side)
    # Two by two cells, as a jump may lie at the border of one.
    votes = votes[:-1, :-1] + votes[1:, :-1] + votes[:-1, 1:] + votes[1:, 1:]
    fullest = np.argsort(-votes.ravel(), kind='stable')[:_JUMPS_TRIED]
    tree, best, shift = cKDTree(seen), 0, None
    for corner in np.stack(np.unravel_index(fullest, votes.shape), axis=-1):
        inside = np.all((cells >= corner) & (cells <= corner + 1), axis=1)
        if not inside.any():
            continue
        candidate = np.median(shifts[inside], axis=0)
        apart = tree.query(predicted + candidate, distance_upper_bound=tolerance)[0]
        fitting = int(np.isfinite(apart).sum())
        if fitting > best:
            best, shift = fitting, candidate
    return shift if best >= max(3, 0.6 * count, at_rest + 2) else None


Mask = NDArray[np.bool_]
_MEASURED = np.array((0, 1, 6))  # Columns of a row of a marker that are x, y and area
_LIGHT = [('id', np.intp), ('area', float), ('hits', np.intp), ('last_seen', float)]


# What distinguishes a known light from a new one. Chosen on the test scenes and on the two LED
# videos with three and five lights.

GATE = 4.0  # standard deviations from its prediction at which a light is another one
ALONE = 0.45  # part of the distance to the nearest other light within which it is itself
WIDEST = 60.0  # px that a light may lie off its prediction, unless all jump together
SAME_JUMP = 5.0  # px by which lights that jump together may differ
SIZE_WEIGHT = 3.0  # of the logarithm of a change in size, as of another light
SIZE_OFFSET = 4.0  # px that soften that for the smallest lights
SIZE_MEMORY = 0.8  # per hit, of a light's usual size
CONFIRMED = 3  # hits from which a light is more than a speck
# So that noise in every frame costs little more than in one:
MAX_TENTATIVE = 50  # specks out of sight that are kept
MAX_VOTERS = 40  # lights that are asked whether all have jumped
MAX_LIGHTS = 400  # lights that are kept


class MultiObjectTracker:
    """Every light of the frame, as persistent as its motion allows.

    The lights of a frame are given to the known ones so that the squared distances from the
    predictions, over their variances, are least in sum. A light out of sight is predicted for
    ``lost_timeout`` and then forgotten; two that run into one are both kept that long.
    """

    def __init__(self) -> None:
        self._newest_id = 0
        self._begin((0, 0))

    def _begin(self, size: tuple[int, int]) -> None:
        """Begin with images of a size, px; no number is given again."""
        self._size = size
        self._motion = MotionPredictor(0)
        self._lights: NDArray[Any] = np.empty(0, _LIGHT)

    def track(self, image: Image, time: float, parameters: MarkerTrackerParameters) -> MarkerResult:
        """Find the lights of the next frame, of a later time (s) than the last one."""
        if self._size != (image.width, image.height):
            self._begin((image.width, image.height))
        predicted = np.array(self._motion.predict(time, parameters.prediction)).reshape(-1, 2)
        status = ''
        try:
            found = find_lights(image, parameters)
            if len(found) > MAX_LIGHTS:
                raise GroupingError(f'{len(found)} lights above the threshold')
        except GroupingError as error:
            status = str(error)
            found = np.empty((0, 3))
        given = self._assign(predicted, found, parameters.search_radius)
        self._update(time, given, found)
        given = self._forget(time - parameters.lost_timeout, given, MAX_LIGHTS - len(found))
        new = np.setdiff1d(np.arange(len(found)), given)
        if len(new):
            self._motion.add(found[new, :2])
            areas = enumerate(found[new, 2], self._newest_id + 1)
            lights = [(number, area, 1, time) for number, area in areas]
            self._newest_id += len(new)
            self._lights = np.concatenate((self._lights, np.array(lights, _LIGHT)))
        return self._result(np.concatenate((given, new)), found, status)

    def _assign(self, predicted: Array, found: Array, search_radius: int) -> Integers:
        """Which detection each known light has; -1 for none."""
        if not (len(predicted) and len(found)):
            return np.full(len(predicted), -1)
        seen = found[:, :2]
        apart, number = choices(predicted, seen, WIDEST)
        # Those can show a jump of all that are well known and were seen in the last frame.
        hits, last_seen = self._lights['hits'], self._lights['last_seen']
        voters = np.flatnonzero((hits >= CONFIRMED) & (last_seen == last_seen.max()))
        voters = voters[np.argsort(-hits[voters], kind='stable')[:MAX_VOTERS]]
        longest, same = 3 * WIDEST, SAME_JUMP
        shift = common_shift(predicted[voters], seen, apart[voters, 0], longest, same)
        if shift is not None:
            apart, number = choices(predicted + shift, seen, WIDEST)
        deviations = self._motion.deviations()
        reach = np.maximum(search_radius, GATE * deviations)[:, None]
        if (apart[:, 0] > reach[:, 0]).any():
            # A light that is alone far and wide may jump further than one among others.
            alone = np.minimum(nearest_other(predicted)[:, None], nearest_other(seen)[number])
            reach = np.maximum(reach, ALONE * alone)
        reach = np.minimum(reach, WIDEST)
        cost = (apart / np.maximum(deviations, 1.0)[:, None]) ** 2
        offset = SIZE_OFFSET
        usual, size = np.log(self._lights['area'] + offset), np.log(found[:, 2] + offset)
        cost += (SIZE_WEIGHT * (usual[:, None] - size[number])) ** 2
        cost[apart > reach] = IMPOSSIBLE
        return assign(cost, number)

    def _update(self, time: float, given: Integers, found: Array) -> None:
        """Measure the known lights."""
        visible = given >= 0
        positions = np.full((len(given), 2), math.nan)
        positions[visible] = found[given[visible], :2]
        self._motion.update(positions.ravel())
        lights = self._lights
        lights['last_seen'][visible] = time
        lights['hits'][visible] += 1
        change = found[given[visible], 2] - lights['area'][visible]
        lights['area'][visible] += (1 - SIZE_MEMORY) * change

    def _forget(self, earliest: float, given: Integers, max_hidden: int) -> Integers:
        """Forget lights that were last seen before a time (s), and the least known of too many."""
        hidden, hits = given < 0, self._lights['hits']
        kept = ~hidden | (self._lights['last_seen'] >= earliest)
        _thin_out(kept, hidden & (hits < CONFIRMED), hits, MAX_TENTATIVE)
        _thin_out(kept, hidden, hits, max_hidden)
        if not kept.all():
            self._motion.keep(kept)
            self._lights = self._lights[kept]
        return given[kept]

    def _result(self, given: Integers, found: Array, status: str) -> MarkerResult:
        motions = np.array(self._motion.motions()).reshape(-1, 4)
        visible = given >= 0
        unknown = np.full(len(given), math.nan)
        rows = np.column_stack((self._motion.positions(), motions, unknown))
        rows[np.ix_(visible, _MEASURED)] = found[given[visible]]
        states = MarkerState.PREDICTED, MarkerState.DETECTED
        markers = tuple(
            Marker(Label.UNLABELLED, states[seen], *row)
            for seen, row in zip(visible.tolist(), rows.tolist(), strict=True)
        )
        hidden = int((~visible).sum())
        if not markers:
            status = status or 'no light in view'
        elif hidden and not status:
            status = f'{len(given) - hidden} detected, {hidden} predicted'
        return MarkerResult(markers, status=status, ids=tuple(self._lights['id'].tolist()))


def _thin_out(kept: Mask, group: Mask, hits: Integers, most: int) -> None:
    """Keep at most so many of a group of lights, those that were seen most often."""
    members = np.flatnonzero(kept & group)
    if len(members) > most:
        min_known = np.argsort(hits[members], kind='stable')
        kept[members[min_known[: len(members) - max(most, 0)]]] = False

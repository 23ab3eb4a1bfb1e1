"""The spots of a frame that may be lights, measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.blobs import Blob, Blobs, may_be_light
from mvuav_ros.vision.markers.centroid import CentroidMeter, Detection, cutter
from mvuav_ros.vision.markers.lens import Lens

ROUND = 1.4  # Spread of a spot that may be a light
LEAST_SHARE = 0.2
"""Of the n-th largest spot's area: what is smaller is no marker of a body with n of them."""
MOST_MEASURED = 24


class Frame:
    """One image, and how its lights are measured.

    Attributes:
        image: its pixels.
        time: its stamp, s.
        number: of the frame.
        size: width and height, px.
        parameters: of the tracker.
        meter: measures a light.
        cut: gives parts of the image.
    """

    def __init__(
        self, image: Image, time: float, number: int, parameters: MarkerTrackerParameters
    ) -> None:
        self.image, self.time, self.number = image, time, number
        self.size = image.width, image.height
        self.meter = CentroidMeter(parameters.threshold, parameters.weighted)
        self.cut = cutter(image)
        self.parameters = parameters

    @property
    def earliest(self) -> float:
        """When a marker out of sight must have been seen to be predicted, s."""
        return self.time - self.parameters.lost_timeout


class Lights:
    """The spots of a frame that may be lights, measured."""

    def __init__(self, frame: Frame, lens: Lens, around: Sequence[float] = ()) -> None:
        """Measure the lights of a frame.

        Of very many the nearest to some places (x and y in turn, px) are measured; the largest,
        which tell what is small, if there are none.

        Raises:
            GroupingError: it is too bright or too noisy to hold markers.
        """
        blobs = Blobs(frame.image.gray(), frame.parameters)
        boxes = [box for box in blobs.boxes if may_be_light(box)]
        if len(boxes) > MOST_MEASURED:
            boxes = _most_useful(boxes, around)
        measured = [blobs.measure(box, frame.cut, frame.meter) for box in boxes]
        self.spots = straightened(lens, measured)  # their places in px without distortion
        self.measured = dict(zip(self.spots, measured, strict=True))  # where the image shows them
        self._boxes = dict(zip(self.spots, boxes, strict=True))
        self._blobs = blobs
        self._lens = lens

    def __len__(self) -> int:
        return len(self.spots)

    def split(
        self, spot: Detection, dx: float, dy: float, variance: float
    ) -> tuple[Detection, Detection]:
        """A spot that is two lights (see `Blobs.split`)."""
        pair = self._blobs.split(self._boxes[spot], dx, dy, variance)
        first, second = straightened(self._lens, pair)
        self.measured[first], self.measured[second] = pair
        return first, second

    def candidates(self, count: int) -> list[Detection]:
        """The round ones that could be among a body's ``count`` markers."""
        spots = [spot for spot in self.spots if spot.spread <= ROUND]
        if len(spots) < count:
            return spots
        least = LEAST_SHARE * spots[count - 1].area
        return [spot for spot in spots if spot.area >= least]


def _most_useful(boxes: Sequence[Blob], around: Sequence[float]) -> list[Blob]:
    if not len(around):
        return sorted(boxes, key=lambda box: -box.area)[:MOST_MEASURED]
    middles = np.array([(box.x0 + box.x1, box.y0 + box.y1) for box in boxes]) / 2
    apart = middles[:, None] - np.reshape(around, (-1, 2))
    nearest = np.abs(apart).max(axis=2).min(axis=1)
    return [boxes[index] for index in np.argsort(nearest, kind='stable')[:MOST_MEASURED]]


def straightened(lens: Lens, spots: Sequence[Detection]) -> list[Detection]:
    """Detections where a lens without distortion would show them."""
    if lens.focal is None or not spots:
        return list(spots)
    ideal = lens.to_ideal(np.array([(spot.x, spot.y) for spot in spots])).tolist()
    return [
        Detection(x, y, spot.area, spot.spread) for spot, (x, y) in zip(spots, ideal, strict=True)
    ]


def places_of(found: Mapping[int, Detection]) -> dict[int, tuple[float, float]]:
    """Where named spots are, px."""
    return {marker: (spot.x, spot.y) for marker, spot in found.items()}


def are_close(a: Detection, b: Detection, distance: float) -> bool:
    """Whether two spots lie less than a distance (px) apart."""
    return (a.x - b.x) ** 2 + (a.y - b.y) ** 2 < distance * distance

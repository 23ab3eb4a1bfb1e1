"""Markers that fit together, though not where their motion was expected to take them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.identity.assignment import Fits
from mvuav_ros.vision.markers.identity.fault_detection import TUNING as FAULTS
from mvuav_ros.vision.markers.identity.reacquisition import MOST_EXTENDED, extend
from mvuav_ros.vision.markers.lights import are_close
from mvuav_ros.vision.markers.view.filter import ViewFilter


@dataclass(frozen=True)
class RecoveryTuning:
    """When lights that were not expected where they are get names.

    Chosen on seeds 0 to 11 of flights of bare lights (`simulation.light_flights`).
    """

    # Lights that must fit at once: a single one that does not go with the others may as well be
    # another light.
    fewest_new: int = 2
    # Frames in a row that must name the lights alike, where they are as few as can tell.
    confirmed: int = 2
    same: float = 40.0  # px, within which a marker may move between two frames


TUNING = RecoveryTuning()


class Recovery:
    """Names more lights with the markers in sight by the rig alone, whatever the motion was."""

    def __init__(self) -> None:
        self._last: dict[int, Detection] = {}
        self._agreed = 0

    def name(
        self,
        views: ViewFilter,
        found: Mapping[int, Detection],
        spots: Sequence[Detection],
        fits: Fits,
    ) -> dict[int, Detection]:
        """The markers found, and spots without a name that fit the rig with them in one way only.

        Where any are named, the views have become as uncertain as that takes.
        """
        fewest = max(-(-FAULTS.fewest_free // 2), len(found) + TUNING.fewest_new)
        if len(found) + min(len(spots), MOST_EXTENDED) < fewest:
            self._agreed = 0
            return dict(found)
        before = views.bank
        views.upset(FAULTS.free)
        named = extend(views, found, spots, fits)
        view = views.look({m: (spot.x, spot.y) for m, spot in named.items()})
        most_cost = FAULTS.fitting_few if len(named) <= fewest else FAULTS.fitting
        if len(named) < fewest or view.cost > most_cost:
            self._agreed = 0
        elif self._believes(named, fewest):
            return named
        views.bank = before
        return dict(found)

    def _believes(self, named: dict[int, Detection], fewest: int) -> bool:
        alike = named.keys() == self._last.keys() and all(
            are_close(spot, self._last[marker], TUNING.same) for marker, spot in named.items()
        )
        self._agreed = self._agreed + 1 if alike and self._agreed else 1
        self._last = named
        return len(named) > fewest or self._agreed >= TUNING.confirmed

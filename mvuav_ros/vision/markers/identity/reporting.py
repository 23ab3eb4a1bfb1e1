"""What is told of a frame: one row for every marker of the rig."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.grouping import roll_of
from mvuav_ros.vision.markers.identity.assignment import Expectation
from mvuav_ros.vision.markers.identity.marker_memory import MarkerMemory
from mvuav_ros.vision.markers.results import (
    TANKER_LABELS,
    TANKER_NAMES,
    Marker,
    MarkerResult,
    MarkerState,
    Window,
    counts_of,
)
from mvuav_ros.vision.rig import MarkerRig


class Reporter:
    """Results of one rig's markers."""

    def __init__(self, rig: MarkerRig) -> None:
        names = rig.names
        self._labels: list[int] = list(range(len(names)))
        if names == TANKER_NAMES:
            self._labels = [*TANKER_LABELS]
        self._wings = None
        if 'left_wing' in names and 'right_wing' in names:
            self._wings = names.index('left_wing'), names.index('right_wing')

    def nothing(self, status: str) -> MarkerResult:
        """All markers are lost."""
        lost = tuple(Marker(label, MarkerState.LOST) for label in self._labels)
        return MarkerResult(lost, status=status, has_wings=self._wings is not None)

    def result(
        self,
        memory: MarkerMemory,
        spots: Sequence[Detection | None],
        earliest: float,
        expected: Mapping[int, Expectation],
        windows: Sequence[Window] = (),
        remark: str = '',
    ) -> MarkerResult:
        """What is told of a frame, by the memory that holds it already.

        A marker without a spot is predicted where it is expected (px) if it was seen since the
        earliest time (s).
        """
        velocity, acceleration = memory.predictor.motions()
        markers = []
        for index, label in enumerate(self._labels):
            i, j = 2 * index, 2 * index + 1
            motion = (velocity[i], velocity[j], acceleration[i], acceleration[j])
            spot = spots[index]
            if spot is not None:
                x, y, area, _ = spot
                markers.append(Marker(label, MarkerState.DETECTED, x, y, *motion, area))
            elif memory.markers[index].last_seen >= earliest and index in expected:
                x, y, _ = expected[index]
                markers.append(Marker(label, MarkerState.PREDICTED, x, y, *motion))
            else:
                markers.append(Marker(label, MarkerState.LOST))
        roll = math.nan
        if self._wings is not None:
            roll = roll_of(*(markers[wing] for wing in self._wings))
        status = remark
        if None in spots:
            status = counts_of(markers) + (f' ({remark})' if remark else '')
        predictions = tuple(zip(memory.told[::2], memory.told[1::2], strict=True))
        has_wings = self._wings is not None
        return MarkerResult(tuple(markers), roll, status, tuple(windows), predictions, has_wings)

"""Flights on which markers vanish, join and are imitated, and what became of their names."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from mvuav_ros.parameters.declaration import Value
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.simulation.settings import TankerSettings
from mvuav_ros.simulation.tanker_flight import MarkerTruth, TankerFlight
from mvuav_ros.vision.markers.marker_results import MarkerResult, MarkerState
from mvuav_ros.vision.markers.tracker import MarkerTracker

NAMED_WRONG = 4.0
"""px from a light's true place at which its name is on something else; lights have a radius of
3.5 to 5."""
SCENES: Mapping[str, Mapping[str, Value]] = {
    'one marker hidden 2 s, then another, during the roll sweep': {
        'motion': 'roll',
        'failures': 'left_wing@1.5-3.5, rudder@4.5-6.5',
    },
    'two markers hidden 2 s during the roll sweep': {
        'motion': 'roll',
        'failures': 'left_wing@1.5-3.5, left_stabilizer@1.5-3.5',
    },
    'both wings hidden 2 s during the roll sweep': {
        'motion': 'roll',
        'failures': 'left_wing@3-5, right_wing@3-5',
    },
    'all hidden 1 s, twice': {'motion': 'roll_translation', 'failures': 'all@2-3, all@5-6'},
    'five hot pixels, three glares': {'motion': 'roll_translation', 'hot_pixels': 5, 'glares': 3},
    'the same, two markers hidden 2 s, then all 1 s': {
        'motion': 'roll',
        'hot_pixels': 5,
        'glares': 3,
        'failures': 'left_wing@1.5-3.5, rudder@1.5-3.5, all@5-6',
    },
    'two markers pass at 5 px': {'motion': 'crossing', 'frames': 400},
    'two markers pass at 5 px, vibration 2': {'motion': 'crossing', 'frames': 400, 'shake': 2},
    'roll through 360°': {'motion': 'roll_360', 'frames': 320},
    'roll through 360°, both wings hidden upside down': {
        'motion': 'roll_360',
        'frames': 320,
        'failures': 'left_wing@4-6, right_wing@4-6',
    },
    '30 % of the frames dropped': {'motion': 'roll_translation', 'drop_probability': 0.3},
    'the same, vibration 2, two markers hidden 2 s': {
        'motion': 'roll',
        'drop_probability': 0.3,
        'shake': 2,
        'failures': 'left_wing@2-4, rudder@2-4',
    },
}
"""Settings of flights that a tracker may lose its names on."""


@dataclass(frozen=True)
class IdentityTask:
    """A flight, and the parameters of the tracker that follows it."""

    scene: str
    flight: TankerSettings
    parameters: MarkerTrackerParameters = field(default_factory=MarkerTrackerParameters)


@dataclass(eq=False)
class NamedFlight:
    """What became of the names on a flight.

    Attributes:
        scene: of the task.
        results: of every frame.
        wrong: frame, marker and px from its true place, for every name on something else.
        imagined: frame, marker and px for every marker out of sight, yet reported as detected.
        switches: how often a name went over from one light to another.
        partial: latencies, frames, from a whole marker's appearance to its name while others
            were named.
        total: latencies where no marker had been named the frame before.
        whole: frames of all whole markers together.
        detected: of these, with a name.
        roll_error: the greatest while both wings were detected, rad, modulo a turn.
    """

    scene: str
    results: tuple[MarkerResult, ...] = ()
    wrong: tuple[tuple[int, str, float], ...] = ()
    imagined: tuple[tuple[int, str, float], ...] = ()
    switches: int = 0
    partial: tuple[int, ...] = ()
    total: tuple[int, ...] = ()
    whole: int = 0
    detected: int = 0
    roll_error: float = 0.0
    _waiting: dict[int, int] = field(default_factory=dict)
    _after_all: set[int] = field(default_factory=set)
    _carrier: dict[int, int] = field(default_factory=dict)

    @property
    def named(self) -> float:
        """Share of the whole markers' frames in which they were detected."""
        return self.detected / max(self.whole, 1)

    @property
    def slowest(self) -> int:
        """The most frames that it took a marker to get its name."""
        return max((*self.partial, *self.total), default=0)

    def add(self, result: MarkerResult, truth: Sequence[MarkerTruth], roll: float) -> None:
        """Score the next frame; ``roll`` is the true one, rad."""
        none_before = not self.results or not any(_detected(self.results[-1]))
        self.results += (result,)
        detected = _detected(result)
        for index, (marker, true) in enumerate(zip(result.markers, truth, strict=True)):
            if detected[index]:
                distances = [math.hypot(marker.x - t.x, marker.y - t.y) for t in truth]
                self._place(index, true, distances)
            self.whole += true.whole
            self.detected += true.whole and detected[index]
            self._wait(index, true.whole, detected[index], none_before)
        if not math.isnan(result.roll) and detected[0] and detected[-1]:
            error = abs(math.remainder(result.roll - roll, 2 * math.pi))
            self.roll_error = max(self.roll_error, error)

    def _place(self, index: int, true: MarkerTruth, distances: list[float]) -> None:
        """Hold a detected marker's distances from all true places against its name."""
        note = (len(self.results) - 1, true.name, distances[index])
        nearest = distances.index(min(distances))
        if distances[index] > NAMED_WRONG or nearest != index:
            self.wrong += (note,)
        elif not true.visible:
            self.imagined += (note,)
        carrier = nearest if distances[nearest] <= NAMED_WRONG else -1
        self.switches += self._carrier.get(index, carrier) != carrier
        self._carrier[index] = carrier

    def _wait(self, index: int, whole: bool, detected: bool, none_before: bool) -> None:
        if not whole:
            self._waiting.pop(index, None)
            self._after_all.discard(index)
            return
        if index not in self._waiting:
            self._waiting[index] = 0
            if none_before:
                self._after_all.add(index)
        if detected:
            self._end_wait(index)
            self._after_all.discard(index)
        else:
            self._waiting[index] += 1

    def _end_wait(self, index: int) -> None:
        latency = (self._waiting.pop(index),)
        if index in self._after_all:
            self.total += latency
        else:
            self.partial += latency

    def close(self) -> None:
        """Count the waits that the flight's end cut short."""
        for index in list(self._waiting):
            self._end_wait(index)


def _detected(result: MarkerResult) -> list[bool]:
    return [marker.state is MarkerState.DETECTED for marker in result.markers]


def identity_task(
    scene: str, seed: int, parameters: MarkerTrackerParameters | None = None
) -> IdentityTask:
    """One of `SCENES` with a seed, 240 frames at 30 frames/s unless the scene says otherwise."""
    settings = TankerSettings.from_mapping(
        {'frames': 240, 'fps': 30.0, **SCENES[scene], 'seed': seed}
    )
    return IdentityTask(scene, settings, parameters or MarkerTrackerParameters())


def fly_names(task: IdentityTask) -> NamedFlight:
    """Follow a flight and hold every name against the truth."""
    tracker = MarkerTracker(task.parameters)
    flown = NamedFlight(task.scene)
    for frame in TankerFlight(task.flight):
        result = tracker.process(frame.image, frame.stamp_ns)
        flown.add(result, frame.truth.markers, frame.truth.roll)
    flown.close()
    return flown

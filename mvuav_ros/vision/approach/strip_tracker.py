"""Several possible runways followed at a time, until it is clear which is the one."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import zip_longest
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.appearance import Scene
from mvuav_ros.vision.approach.attitude import Derotation, turn_strips
from mvuav_ros.vision.approach.ground_motion import Overlaid, Registration
from mvuav_ros.vision.approach.probability import log_odds_of
from mvuav_ros.vision.approach.search import (
    NO_CANDIDATES,
    Candidates,
    LevelledImage,
    fan_jobs,
    find_candidates,
)
from mvuav_ros.vision.approach.sight import SearchRange, Sight
from mvuav_ros.vision.approach.strip_edges import LevelledFrame
from mvuav_ros.vision.approach.strips import FollowedStrip
from mvuav_ros.vision.approach.track import RunwayTrack, View
from mvuav_ros.vision.approach.tuning import MOTION, SEARCH, TRACKER


def _chunks(where: SearchRange) -> Iterator[tuple[SearchRange, int, int, list[float]]]:
    """What is searched in one frame after the other: range, level, depth, and rows."""
    for level in range(SEARCH.levels):
        for depth, rows in fan_jobs(where.first / 2**level, where.last / 2**level, level):
            for start in range(0, len(rows), TRACKER.chunk):
                yield where, level, depth, rows[start : start + TRACKER.chunk]


TrackT = TypeVar('TrackT', bound=FollowedStrip)


class StripTracker(Generic[TrackT]):
    """Several strips followed at a time: a runway, a road or a pipeline."""

    below_horizon = True
    """The target is looked for below the horizon alone."""

    def __init__(self, max_tracks: int, switch_margin: float) -> None:
        """How many are followed, and by what log odds another must be better than that shown."""
        self.tracks: list[TrackT] = []
        self.best: TrackT | None = None  # the one that is shown
        self._max_tracks, self._switch_margin = max_tracks, switch_margin
        self.level: Derotation | None = None  # of the last frame
        self.registration = Registration()
        self._frame = 0
        self._unlike = 0  # images in a row that show nothing of what the one before them did

    @property
    def confidence(self) -> float:
        """Of the best track, 0 to 1."""
        return 0.0 if self.best is None else self.best.confidence

    @property
    def certain(self) -> bool:
        """What is shown is likelier what is looked for than not."""
        return self.best is not None and self.best.rank > 0.0

    def _move(self, level: Derotation, pixels: NDArray[Any]) -> bool:
        """Move the tracks as the next working image has, levelled so; whether it shows anything.

        One that does not is left out, as if it had not come: all will be about where it was.
        """
        self.registration.take(pixels)
        if self.level is not None:
            for track in self.tracks:
                track.turn(self.level, level)
        self.level = level
        shifts = [self.registration.shift(track.strip(), level) for track in self.tracks]
        self._unlike = self._unlike + 1 if self.registration.alike < MOTION.min_alike else 0
        # Where it goes on it is another scene, or one that moves too fast.
        is_left_out = 0 < self._unlike <= MOTION.max_unlike
        if is_left_out or self.registration.is_plain:
            self.registration.leave_out()
            return False
        for track, shift in zip(self.tracks, shifts, strict=True):
            track.shape.predict(*shift)
        return True

    def _admit(self, track: TrackT) -> bool:
        """Follow another one, for which the worst may have to go; whether there is room."""
        if len(self.tracks) >= self._max_tracks:
            worst = min((t for t in self.tracks if t is not self.best), key=lambda t: t.rank)
            if worst.rank > track.rank:
                return False
            self.tracks.remove(worst)
        self.tracks.append(track)
        return True

    def _merge(self) -> None:
        kept: list[TrackT] = []
        for track in sorted(self.tracks, key=lambda t: (t is not self.best, -t.rank)):
            if not any(other.covers(track.strip()) for other in kept):
                kept.append(track)
        self.tracks = kept

    def _choose(self) -> None:
        if self.best not in self.tracks:
            self.best = None
        least = -math.inf if self.best is None else self.best.preference + self._switch_margin
        for track in self.tracks:
            if track is not self.best and track.showable and track.preference > least:
                self.best, least = track, track.preference + self._switch_margin


class RunwayTracker(StripTracker[RunwayTrack]):
    """Finds and follows the runway on the levelled working images of one size."""

    def __init__(self) -> None:
        super().__init__(TRACKER.max_tracks, TRACKER.switch_margin)
        self._scene: Scene | None = None
        self._overlaid = Overlaid()
        self._job = self._rounds = 0

    def step(self, frame: LevelledFrame, pixels: NDArray[Any], sight: Sight) -> RunwayTrack | None:
        """The likeliest track in the next frame, of which ``pixels`` are the working image."""
        if not self._move(frame.level, pixels):
            return self.best
        self._overlaid.take(self.registration.gray)
        scene = self._scene if self._frame % TRACKER.scene_frames else None
        working = LevelledImage(pixels, frame.level, scene, self._overlaid.mask)
        view = View(frame, working, sight, self.registration, self._overlaid.motion)
        for track in self.tracks:
            shown = track is self.best
            others = TRACKER.period_certain if self.certain else TRACKER.others_period
            track.step(view, TRACKER.best_period if shown else others, shown=shown)
        self.tracks = [t for t in self.tracks if not t.lost and t.log_odds > TRACKER.min_odds]
        self._merge()
        period = TRACKER.period_later if self._rounds else TRACKER.period_first
        if self._frame % (TRACKER.period_certain if self.certain else period) == 0:
            self._start(self._search(view, sight), view)
        self._frame += 1
        self._scene = working.whole_scene
        self._choose()
        return self.best

    def _search(self, view: View, sight: Sight) -> Candidates:
        """What is likeliest at once; after that the next few rows on one level at one depth."""
        if self._frame == 0:
            # Without a horizon no range is likelier than the others.
            ranges = sight.ranges if sight.row is None else sight.ranges[:1]
            return find_candidates(view.working, *(where[1:] for where in ranges))
        turns = zip_longest(*map(_chunks, sight.ranges))
        chunks = [chunk for turn in turns for chunk in turn if chunk is not None]
        if not chunks:
            return NO_CANDIDATES
        self._rounds, number = divmod(self._job, len(chunks))
        where, level, depth, rows = chunks[number]
        self._job += 1
        image = view.working.at_slope(where.slope)
        found = image.search(level, [(depth, rows)], TRACKER.max_weighed)
        turned = turn_strips(found.strips, image.level, view.working.level)
        return found._replace(strips=turned)

    def _start(self, found: Candidates, view: View) -> None:
        """Give the likeliest candidates to the tracks that they belong to, or follow them anew."""
        odds = log_odds_of(found.features)
        least = float(odds.max(initial=-np.inf)) - TRACKER.max_below_best
        fresh: list[RunwayTrack] = []
        for index in np.argsort(-odds, kind='stable'):
            strip = found.strips[index]
            if odds[index] < max(TRACKER.min_start_odds, least):
                break
            known = next((track for track in self.tracks if track.covers(strip)), None)
            if known is not None:
                known.add(strip)
            elif self._admit(track := RunwayTrack(strip, float(odds[index]))):
                fresh.append(track)
        for track in fresh:
            track.step(view, 1)
        self.tracks = [track for track in self.tracks if not track.lost]

"""When to name a whole body, and when to believe it."""

from __future__ import annotations

from dataclasses import dataclass

from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.identity.initialization import Named
from mvuav_ros.vision.markers.lights import are_close

LONGEST_REST = 15
"""Frames between two attempts to name lights that could not be named, at most."""


CONFIRMED = 3
"""Frames in which a body must be named alike where one frame does not make it certain."""
CONFIRMED_ODD = 10
"""The same where one of the lights may well be another one, which by then has gone elsewhere."""
SAME_MISFIT = (0.2, 0.25)
"""px, and part of it, by which the misfit may change meanwhile: that of a rig measured badly stays,
that of a light that is no marker does not."""


@dataclass
class Attempts:
    """When to name a whole body: the more often that failed, the less often it is tried.

    Attributes:
        count: markers of the body.
        agreed: frames in a row that named the body alike.
        last: places of its markers in the last one.
    """

    count: int
    agreed: int = 0
    last: tuple[Detection, ...] = ()
    _failures: int = 0
    _rest: int = 0
    _lights: int = 0
    _first_misfit: float = 0.0

    def due(self, lights: int) -> bool:
        """Whether to try in this frame.

        Args:
            lights: in it; another number than before may be what was waited for.
        """
        if lights != self._lights:
            complete = self._lights < self.count <= lights
            self._lights, self._rest = lights, 0 if complete else min(self._rest, 1)
        self._rest -= 1
        return self._rest < 0

    def fail(self) -> None:
        """No way of naming the lights stood out."""
        self.agreed, self.last = 0, ()
        self._rest = min(self._failures, LONGEST_REST)
        self._failures = 2 * self._failures + 1 if self._failures < LONGEST_REST else LONGEST_REST

    def confirmed(self, named: Named) -> bool:
        """Whether enough frames in a row have named the body alike."""
        return named.certain or self.agreed >= (CONFIRMED_ODD if named.odd else CONFIRMED)

    def succeed(self, named: Named) -> bool:
        """Take a way of naming them; whether it is that of the last attempt."""
        assert named.view is not None
        reach = 0.5 * named.view.scale
        alike = all(are_close(a, b, reach) for a, b in zip(self.last, named.spots, strict=False))
        most = SAME_MISFIT[0] + SAME_MISFIT[1] * self._first_misfit
        changed = abs(named.view.misfit - self._first_misfit) > most
        goes_on = alike and bool(self.last) and not (named.odd and changed)
        self.agreed = self.agreed + 1 if goes_on else 1
        if not goes_on:
            self._first_misfit = named.view.misfit
        self.last, self._failures, self._rest = named.spots, 0, 0
        return alike

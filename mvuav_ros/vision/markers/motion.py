"""One marker's recent positions: its velocity and acceleration, and where it will be next."""

from __future__ import annotations

from mvuav_ros.vision.markers.results import NAN

Vector = tuple[float, float]
UNKNOWN: Vector = (NAN, NAN)


class Motion:
    """The positions at which a marker was last seen.

    Times are seconds on the images' own clock: the thesis's program took its processing time
    for the time step, so that one slow frame threw the estimate off by 8 to 10 px.
    """

    def __init__(self) -> None:
        self._seen: list[tuple[float, float, float]] = []
        # px/s between the two newest positions (eqs 3.14, 3.15); NaN before there are two.
        self.velocity: Vector = UNKNOWN
        # px/s² from the three newest positions (eqs 3.16, 3.17); NaN before there are three. Each
        # velocity belongs to the middle of its interval; with equal time steps this is eq. 3.16 to
        # the letter.
        self.acceleration: Vector = UNKNOWN

    @property
    def last_seen(self) -> float:
        """The time of the newest position, s."""
        return self._seen[-1][0]

    def add(self, time: float, x: float, y: float) -> None:
        """Append a position (px), later than the last one."""
        seen = self._seen
        seen.append((time, x, y))
        if len(seen) < 2:
            return
        t1, x1, y1 = seen[-2]
        newer = time - t1
        vx, vy = self.velocity = ((x - x1) / newer, (y - y1) / newer)
        if len(seen) < 3:
            return
        t0, x0, y0 = seen[-3]
        older, between = t1 - t0, 0.5 * (time - t0)
        self.acceleration = (
            (vx - (x1 - x0) / older) / between,
            (vy - (y1 - y0) / older) / between,
        )
        del seen[:-2]

    def predict(self, time: float, method: str, steps_unseen: int = 0) -> Vector:
        """Where the marker should be (px) at a time (s) after it was last seen.

        Args:
            time: s, later than `last_seen`.
            method: ``none``, ``velocity`` (eq. 4.1), ``acceleration`` (eqs 3.18, 4.2), or
                ``acceleration_program``: Appendix C as coded, whose acceleration is (older minus
                newer velocity) over two time steps, a smoother instead of an extrapolator.
            steps_unseen: frames since the marker was last seen, before this one. An
                acceleration from three positions cannot be trusted for longer than one frame,
                so a marker out of sight is carried on by its velocity.
        """
        last, x, y = self._seen[-1]
        vx, vy = self.velocity
        if method == 'none' or self.velocity is UNKNOWN:
            return x, y
        ahead = time - last
        x, y = x + vx * ahead, y + vy * ahead
        ax, ay = self.acceleration
        if method == 'velocity' or steps_unseen or self.acceleration is UNKNOWN:
            return x, y
        half = 0.5 * ahead * ahead
        if method == 'acceleration_program':
            half *= -0.5
        return x + ax * half, y + ay * half

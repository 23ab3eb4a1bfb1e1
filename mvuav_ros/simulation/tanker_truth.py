"""What is true of an image of the tanker."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from mvuav_ros.simulation.camera import PinholeCamera
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, Matrix, Vector


class MarkerTruth(NamedTuple):
    """One light.

    Attributes:
        name: of the light.
        x: px, where its centre is projected, in the frame or not; NaN behind the camera.
        y: px.
        vx: px/s, the camera's shake included.
        vy: px/s.
        visible: it is lit, its centre is on the frame and not behind the boom.
        whole: all of its disc is visible, so that a centroid can be right.
    """

    name: str
    x: float
    y: float
    vx: float
    vy: float
    visible: bool
    whole: bool


@dataclass(frozen=True, eq=False)
class TankerTruth:
    """What an image of the tanker shows.

    Attributes:
        time: s since the start of the flight.
        markers: in the rig's order.
        roll: rad, right wing down positive: atan2 of right wing minus left wing as projected; for
            a body without lights of these names, of its rotation.
        rotation: (3, 3), of the body (x forward, y left, z up) in the camera's optical frame.
        translation: (3,), m, of the body's origin in the optical frame.
        distance: from the camera to the body's dock point, m.
        gain: by which the camera's image is brighter than usual.
        camera: with its matrix K and distortion.
    """

    time: float
    markers: tuple[MarkerTruth, ...]
    roll: float
    rotation: Matrix
    translation: Vector
    distance: float
    gain: float
    camera: PinholeCamera

    def marker(self, name: str) -> MarkerTruth:
        """The light of that name.

        Raises:
            KeyError: there is none.
        """
        return {marker.name: marker for marker in self.markers}[name]


def true_roll(markers: Sequence[MarkerTruth], rotation: Matrix) -> float:
    """Roll (rad) from left_wing to right_wing, or without them that of the body's rotation."""
    places = {marker.name: marker for marker in markers}
    if not {'left_wing', 'right_wing'} <= places.keys():
        body = OPTICAL_FROM_BODY.T @ rotation
        return math.atan2(float(body[2, 1]), float(body[2, 2]))
    left, right = places['left_wing'], places['right_wing']
    return math.atan2(right.y - left.y, right.x - left.x)

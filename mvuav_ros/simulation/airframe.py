"""The shape of a Boeing 747-like tanker, in metres: x forward, y left, z up."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

from mvuav_ros.simulation.mesh import Face, Lighting, Mesh

Point = tuple[float, float, float]

IN_SKY = Lighting(ambient=40.0, direct=52.0, towards=(-0.55, 0.52, 0.65))
IN_LAB = Lighting(ambient=26.0, direct=66.0, towards=(-0.60, 0.33, 0.73))
"""Darker than any background, as an aircraft against the light and a grey model are."""

_FUSELAGE = (
    (33.0, 0.15, -0.9),
    (32.0, 1.3, -0.7),
    (29.0, 2.6, -0.3),
    (24.0, 3.25, 0.0),
    (6.0, 3.25, 0.0),
    (-16.0, 3.25, 0.0),
    (-24.0, 2.7, 0.5),
    (-31.0, 1.7, 1.2),
    (-36.0, 0.8, 1.9),
    (-38.0, 0.3, 2.2),
)
_UPPER_DECK = ((30.0, 0.6, 2.0), (26.5, 2.3, 2.3), (14.0, 2.3, 2.3), (4.0, 0.5, 2.4))
"""Stations from nose to tail: x, radius, z of the axis."""


class Section(NamedTuple):
    """One section of a wing: leading edge, chord, where it is, thickness (m)."""

    leading_x: float
    chord: float
    y: float
    z: float
    thickness: float


_WING = (
    Section(13.0, 15.5, 2.6, -2.2, 1.9),
    Section(6.3, 10.6, 12.0, -1.1, 1.2),
    Section(-1.6, 6.8, 22.0, 0.1, 0.6),
    Section(-8.2, 3.9, 29.7, 1.0, 0.3),
)
_STABILIZER = (
    Section(-27.5, 8.0, 0.8, 1.7, 0.8),
    Section(-31.5, 5.2, 6.0, 2.4, 0.5),
    Section(-34.6, 2.5, 10.9, 3.0, 0.25),
)
_FIN = (
    Section(-22.0, 12.5, 0.0, 2.6, 0.9),
    Section(-28.0, 8.7, 0.0, 7.5, 0.6),
    Section(-33.0, 3.6, 0.0, 12.8, 0.3),
)
_ENGINES = ((6.6, 11.7, -3.4), (-2.2, 20.9, -2.0))
"""Middle of the left nacelles."""


@lru_cache(maxsize=1)
def tanker_mesh() -> Mesh:
    """The whole aircraft."""
    return Mesh.of(_faces())


def _faces() -> Iterator[Face]:
    yield from _turned(_FUSELAGE, 16, 0.95)
    yield from _turned(_UPPER_DECK, 12, 0.95)
    for side in (1.0, -1.0):
        for sections in (_WING, _STABILIZER):
            outlines = [[(x, side * y, z) for x, y, z in _outline(s)] for s in sections]
            yield from _closed(outlines, 0.85)
        for x, y, z in _ENGINES:
            yield from _engine(x, side * y, z)
    # The fin is a wing stood on end: its thickness lies along y.
    fin = []
    for section in _FIN:
        (leading, _, z), (top, *_), (trailing, *_), _ = _outline(section)
        half = 0.5 * section.thickness
        fin.append([(leading, 0.0, z), (top, half, z), (trailing, 0.0, z), (top, -half, z)])
    yield from _closed(fin, 0.9)


def _turned(stations: Sequence[Point], sides: int, albedo: float) -> Iterator[Face]:
    """A body of revolution about an axis along x that may bend."""
    angles = [2 * math.pi * k / sides for k in range(sides)]
    yield from _skin(
        [[(x, r * math.cos(a), z + r * math.sin(a)) for a in angles] for x, r, z in stations],
        albedo,
    )


def _skin(rings: Sequence[Sequence[Point]], albedo: float) -> Iterator[Face]:
    """Faces from each ring of points to the next."""
    for front, back in pairwise(rings):
        for k in range(len(front)):
            following = (k + 1) % len(front)
            yield (front[k], front[following], back[following], back[k]), albedo


def _closed(outlines: Sequence[Sequence[Point]], albedo: float) -> Iterator[Face]:
    """A wing of outlines from the root to the tip, which is closed."""
    yield from _skin(outlines, albedo)
    yield outlines[-1], albedo


def _outline(section: Section) -> tuple[Point, Point, Point, Point]:
    """Leading edge, top, trailing edge and bottom."""
    x, chord, y, z, thickness = section
    thickest = x - 0.35 * chord
    top, bottom = z + 0.6 * thickness, z - 0.4 * thickness
    return (x, y, z), (thickest, y, top), (x - chord, y, z), (thickest, y, bottom)


def _engine(x: float, y: float, z: float) -> Iterator[Face]:
    stations = ((x + 3.0, 1.15, z), (x + 1.6, 1.4, z), (x - 1.2, 1.2, z), (x - 2.6, 0.75, z))
    for corners, albedo in _turned(stations, 10, 0.75):
        yield [(cx, cy + y, cz) for cx, cy, cz in corners], albedo
    # The nozzle from behind, and the pylon up to the wing.
    nozzle = ((-0.55, -0.55), (0.55, -0.55), (0.55, 0.55), (-0.55, 0.55))
    yield [(x - 2.62, y + across, z + up) for across, up in nozzle], 0.35
    pylon = ((1.5, 1.2), (-2.0, 1.0), (-5.5, 2.1), (-1.0, 2.1))
    yield [(x + ahead, y, z + up) for ahead, up in pylon], 0.7

"""What is looked for: the shape models of a road's lane and of a pipeline."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class EdgeProfile:
    """What tells the strip from the land beside it.

    Lengths are in widths of the strip.

    Attributes:
        gap: from an edge to where the outside begins.
        least_gap: the same, px.
        inset: from an edge to where the inside begins.
        inside: of the inside that is compared with each side.
        flank: of the outside that is compared on each side.
        brightness: weight of brightness against colourfulness.
        floor: grey levels; contrast of a row that speaks neither for nor against a strip.
        painted: the edges are bright lines, not the borders of a surface.
    """

    gap: float = 0.08
    least_gap: float = 0.4
    inset: float = 0.1
    inside: float = 0.3
    flank: float = 0.6
    brightness: float = 0.6
    floor: float = 7.0
    painted: bool = False


@dataclass(frozen=True)
class Target:
    """The differences between the things that are straight strips on the ground.

    Widths are in camera heights above the ground, which is what the image shows: the strip's
    edges move apart by that many pixels per pixel below the horizon, at any focal length.

    Attributes:
        look: what tells it from the land. Painted lines are looked for everywhere: the camera is
            taken to be level, its horizon where they meet. Other strips are looked for below the
            horizon.
        usual_widths: width over height below and above which a shape is less and less likely.
        widest: greatest width over height of a shape that is followed.
        usual_offset: of the camera from the strip's middle, in widths, above which a shape is less
            and less likely.
        offset_spread: standard deviation of offsets beyond.
        farthest_aside: most offset of a shape that is followed.
        least_support: of the edges, 0 to 1, below which a shape counts as not seen.
        start_score: merit above which a frame speaks for a shape.
        keep_score: quality below which a shape is no longer believed.
    """

    look: EdgeProfile
    usual_widths: tuple[float, float]
    widest: float
    usual_offset: float
    offset_spread: float
    farthest_aside: float
    least_support: float
    start_score: float
    keep_score: float


ROAD = Target(
    look=EdgeProfile(
        gap=-0.008, least_gap=-9.0, inset=0.05, inside=0.45, flank=0.03, floor=5.0, painted=True
    ),
    usual_widths=(1.6, 4.0),
    widest=9.0,
    usual_offset=0.25,
    offset_spread=0.1,
    farthest_aside=0.5,
    least_support=0.3,
    start_score=0.5,
    keep_score=0.3,
)
PIPELINE = Target(
    look=EdgeProfile(),
    usual_widths=(0.03, 0.6),
    widest=2.0,
    usual_offset=2.0,
    offset_spread=2.0,
    farthest_aside=6.0,
    least_support=0.15,
    start_score=1.0,
    keep_score=0.8,
)
TARGETS = {'road': ROAD, 'pipeline': PIPELINE}

"""The constants with which a runway is searched, weighed and followed."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TuningParameters:
    """Constants of the search for a runway; lengths are px of an image of about 320 px width.

    Chosen on the tuning half of the footage: the flights of runs 3 and 5, the cockpit stills of
    every other video, the country and the forest road. Run 2, the other stills and the motorway
    were looked at for figures alone.

    Attributes:
        step_reach: px on each side over which a step of brightness or colour is averaged; the
            blur of edges in run 3.
        ridge_reaches: px from the middle of a painted line to where it must be darker; lines of
            1 to 3 px width, in run 3 and in the simulator.
        texture_window: width and height, px, over which local texture is averaged; far larger
            than the lines, far smaller than fields.
        brightness_floor: grey levels of texture that smooth land is taken to have at least: the
            noise and JPEG error of run 3 and the stills.
        colour_floor: grey levels, as ``brightness_floor``, for both opponent colours.
        most_evidence: textures at which a step or a ridge counts most, so that one bright lamp is
            not a runway.
        weights: of evidence of brightness, blue against yellow, red against green, and paint.
        row_bias: evidence of a row that speaks neither for nor against a strip.
        depths: px below the vanishing point of near ends that are searched on one level of the
            pyramid; the next level has twice these.
        first_row: share of the near end's depth at which the compared part of a strip begins.
        samples: rows compared in the search.
        edges_kept: strongest edges through one vanishing point that are paired.
        steepest: columns per row of the flattest edge searched.
        narrowest: px; a narrower near end tells nothing.
        widest: width over camera height of the widest strip searched (a landing flare is wider,
            and followed, not found).
        widest_above: the same of a strip whose edges meet above the image: near by. The simulated
            flights whose cameras look down.
        farthest_aside: lateral offset over width of the farthest strip searched.
        candidates: kept on the finest level of the pyramid; half as many on the others.
        attitude_reach: px of the working image over which the vanishing point is searched about a
            horizon known from attitude; 6 px and 1 degree are expected of it.
        attitude_sigma: px, standard deviation of that horizon.
        image_horizon_sigma: px, standard deviation of a horizon seen in the image about the
            vanishing point: the far land's edge is not at infinity, and lenses bend it.
        horizon_reach: px above and below a horizon seen in the image.
    """

    step_reach: int = 2
    ridge_reaches: tuple[int, int] = (2, 3)
    texture_window: tuple[int, int] = (61, 15)
    brightness_floor: float = 2.0
    colour_floor: float = 2.5
    most_evidence: float = 4.0
    weights: tuple[float, float, float, float] = (1.0, 0.8, 0.8, 1.2)
    row_bias: float = 0.9
    depths: tuple[int, ...] = (10, 14, 20, 28)
    first_row: float = 0.4
    samples: int = 8
    edges_kept: int = 7
    steepest: float = 1.8
    narrowest: float = 6.0
    widest: float = 1.5
    widest_above: float = 3.0
    farthest_aside: float = 1.2
    candidates: int = 60
    attitude_reach: float = 10.0
    attitude_sigma: float = 6.0
    image_horizon_sigma: float = 8.0
    horizon_reach: tuple[float, float] = (20.0, 60.0)


TUNING = TuningParameters()

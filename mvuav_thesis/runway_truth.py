"""What truth adds to Figures 5.12 to 5.15: how right the lines are, and mode approach's."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from mvuav_ros.offline.evaluation.metrics import ALONG
from mvuav_ros.offline.report import Figure, Table
from mvuav_ros.offline.report_figures import drawing, label
from mvuav_thesis.comparison import SHIPPED, Claim
from mvuav_thesis.plan import words
from mvuav_thesis.runway_runs import FlownRunway
from mvuav_thesis.runway_stages import THESIS_YAML

APPROACH = 'mode approach'
FIRST_JUDGED = 25
"""Frames in which mode approach may still be looking."""
RIGHT_LIMIT, WRONG_LIMIT = 60.0, 2.0
"""Percent of frames: both edges right at least, confident and wrong at most."""


class Shares(NamedTuple):
    """Percent of the frames judged: both edges right, confident and wrong; and their number."""

    right: float
    wrong: float
    frames: int

    @property
    def hold(self) -> bool | None:
        """Whether they keep to the limits; None without a frame."""
        return (self.right >= RIGHT_LIMIT and self.wrong <= WRONG_LIMIT) if self.frames else None


def shares(flight: FlownRunway) -> Shares:
    """Mode approach on a flight."""
    run = flight.runs[APPROACH]
    judged = [
        (right, wrong)
        for right, wrong in list(zip(run.right, run.wrong, strict=True))[FIRST_JUDGED:]
        if right is not None
    ]
    if not judged:
        return Shares(math.nan, math.nan, 0)
    right, wrong = (100.0 * sum(values) / len(judged) for values in zip(*judged, strict=True))
    return Shares(right, wrong, len(judged))


def found_table(scenes: Mapping[str, FlownRunway]) -> Table:
    """Which true lines the scheme finds, and how well."""
    return Table.of(
        'runway_truth',
        'What truth adds to Figures 5.12 to 5.15: lines found, and their error',
        'scene | by | line | found [% of frames] .1 | distance, RMS [px] .2 '
        '| direction, RMS [°] .2',
        [
            (scene, name, words(role.name.lower()), *flight.runs[name].numbers(number))
            for scene, flight in scenes.items()
            for name in (THESIS_YAML, SHIPPED, APPROACH)
            for number, role in enumerate(ALONG)
        ],
        'Of the frames in which the line crosses the middle of the rows. Errors are those of '
        'the lines found, at that row.',
    )


def approach_table(scenes: Mapping[str, FlownRunway]) -> Table:
    """Mode approach on every scene, against its limits."""
    judged = {scene: shares(flight) for scene, flight in scenes.items()}
    failing = [scene for scene, share in judged.items() if not share.hold]
    said = f'Outside of the limits: {", ".join(failing)}.' if failing else 'All within the limits.'
    return Table.of(
        'approach',
        'Mode approach: both edges of the runway, each told apart',
        'scene | frames | both edges right [%] .1 | at least [%] .0 '
        '| confident and wrong [%] .1 | at most [%] .0',
        [
            (scene, count, right, RIGHT_LIMIT, wrong, WRONG_LIMIT)
            for scene, (right, wrong, count) in judged.items()
        ],
        f'From frame {FIRST_JUDGED + 1} on, of frames in which both edges cross the middle of '
        f'the rows; no attitude is given. {said}',
    )


def approach_claims(scenes: Mapping[str, FlownRunway]) -> list[Claim]:
    """A row of the summary for each scene."""
    return [
        Claim(
            f'Mode approach finds both edges: {scene}',
            f'right at least {RIGHT_LIMIT:g} %, wrong at most {WRONG_LIMIT:g} % (ours)',
            f'{share.right:.1f} % right, {share.wrong:.1f} % confident and wrong'
            if share.frames
            else 'no frame to judge',
            share.hold,
        )
        for scene, share in ((scene, shares(flight)) for scene, flight in scenes.items())
    ]


def scene_figure(key: str, title: str, flight: FlownRunway) -> Figure:
    """Three frames of a scene with the lines found and the true ones."""
    run = flight.runs[THESIS_YAML]
    with drawing(9.6, 2.9) as canvas:
        panels = canvas.figure.subplots(1, len(run.images), sharey=True, squeeze=False)[0]
        for number, (axes, image) in enumerate(zip(panels, run.images, strict=True)):
            height, width = image.overlay.shape[:2]
            axes.imshow(image.overlay, interpolation='lanczos')
            for x1, y1, x2, y2 in image.segments:
                axes.plot([x1, x2], [y1, y2], ':', color='white', lw=2.0)
                axes.plot([x1, x2], [y1, y2], ':', color='#0072b2', lw=1.2)
            axes.set_xlim(-0.5, width - 0.5)
            axes.set_ylim(height - 0.5, -0.5)
            axes.grid(visible=False)
            label(axes, f'{image.time:.1f} s', 'x [px]', '' if number else 'y [px], down')
    return canvas.as_figure(
        key,
        title,
        f'{title}: three frames with lines',
        f'With {THESIS_YAML}. Solid green: lines believed; dashed: held by the rho/theta '
        'correction, in the colour of their flags. Dotted blue on white: the true edges and '
        'centreline. Brackets: the rows searched.',
    )

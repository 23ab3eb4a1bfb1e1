"""What truth adds to Figures 5.12 to 5.15: how right the lines are, and mode approach's."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from mvuav_ros.offline.evaluation.numbers import rms
from mvuav_ros.offline.evaluation.runway_runs import ALONG, FlownRunway, RunwayRun
from mvuav_ros.offline.report.comparison import SHIPPED
from mvuav_ros.offline.report.model import Cell, Claim, Column, Figure, Table
from mvuav_ros.offline.report.style import drawing, label
from mvuav_ros.offline.thesis.runway_stages import THESIS_YAML

APPROACH = 'mode approach'
FIRST_JUDGED = 25
"""Frames in which mode approach may still be looking."""
RIGHT_LIMIT, WRONG_LIMIT = 60.0, 2.0
"""Percent of frames: both edges right at least, confident and wrong at most."""


def found_table(scenes: Mapping[str, FlownRunway]) -> Table:
    """Which true lines the scheme finds, and how well."""
    rows: list[tuple[Cell, ...]] = []
    for scene, flight in scenes.items():
        for name in (THESIS_YAML, SHIPPED, APPROACH):
            run = flight.runs[name]
            for number, role in enumerate(ALONG):
                matches = run.of(number)
                visible = run.visible[number]
                rows.append(
                    (
                        scene,
                        name,
                        role.name.lower().replace('_', ' '),
                        100.0 * len(matches) / visible if visible else math.nan,
                        rms(np.array([m.distance for m in matches])),
                        math.degrees(rms(np.array([m.dtheta for m in matches]))),
                    )
                )
    return Table(
        'runway_truth',
        'What truth adds to Figures 5.12 to 5.15: lines found, and their error',
        (
            Column('scene'),
            Column('by'),
            Column('line'),
            Column('found', '% of frames', 1),
            Column('distance, RMS', 'px', 2),
            Column('direction, RMS', '°', 2),
        ),
        tuple(rows),
        (
            'Of the frames in which the line crosses the middle of the rows. Errors are those of '
            'the lines found, at that row.',
        ),
    )


def shares(run: RunwayRun) -> tuple[float, float, int]:
    """Percent of frames with both edges right, percent confident and wrong, frames judged."""
    judged = [
        (right, wrong)
        for right, wrong in list(zip(run.right, run.wrong, strict=True))[FIRST_JUDGED:]
        if right is not None
    ]
    if not judged:
        return math.nan, math.nan, 0
    count = len(judged)
    return (
        100.0 * sum(bool(right) for right, _ in judged) / count,
        100.0 * sum(wrong for _, wrong in judged) / count,
        count,
    )


def approach_table(scenes: Mapping[str, FlownRunway]) -> Table:
    """Mode approach on every scene, against its limits."""
    rows: list[tuple[Cell, ...]] = []
    for scene, flight in scenes.items():
        right, wrong, count = shares(flight.runs[APPROACH])
        rows.append((scene, count, right, RIGHT_LIMIT, wrong, WRONG_LIMIT))
    failing = [str(row[0]) for row in rows if not _approach_holds(scenes[str(row[0])])]
    said = f'Outside of the limits: {", ".join(failing)}.' if failing else 'All within the limits.'
    return Table(
        'approach',
        'Mode approach: both edges of the runway, each told apart',
        (
            Column('scene'),
            Column('frames'),
            Column('both edges right', '%', 1),
            Column('at least', '%', 0),
            Column('confident and wrong', '%', 1),
            Column('at most', '%', 0),
        ),
        tuple(rows),
        (
            f'From frame {FIRST_JUDGED + 1} on, of frames in which both edges cross the middle of '
            f'the rows; no attitude is given. {said}',
        ),
    )


def _approach_holds(flight: FlownRunway) -> bool | None:
    right, wrong, count = shares(flight.runs[APPROACH])
    return (right >= RIGHT_LIMIT and wrong <= WRONG_LIMIT) if count else None


def approach_claims(scenes: Mapping[str, FlownRunway]) -> list[Claim]:
    """A row of the summary for each scene."""
    claims = []
    for scene, flight in scenes.items():
        right, wrong, count = shares(flight.runs[APPROACH])
        ours = (
            f'{right:.1f} % right, {wrong:.1f} % confident and wrong'
            if count
            else 'no frame to judge'
        )
        claims.append(
            Claim(
                f'Mode approach finds both edges: {scene}',
                f'right at least {RIGHT_LIMIT:g} %, wrong at most {WRONG_LIMIT:g} % (ours)',
                ours,
                _approach_holds(flight),
            )
        )
    return claims


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
    return Figure(
        key,
        title,
        canvas.png,
        f'{title}: three frames with lines',
        (
            f'With {THESIS_YAML}. Solid green: lines believed; dashed: held by the rho/theta '
            'correction, in the colour of their flags. Dotted blue on white: the true edges and '
            'centreline. Brackets: the rows searched.',
        ),
    )

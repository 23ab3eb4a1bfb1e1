"""Figures 5.12 to 5.15: runway figures with lines, and how right the lines are."""

from __future__ import annotations

import math

import numpy as np

from mvuav_ros.offline.evaluation.line_errors import DISTANCE_LIMIT, THETA_LIMIT
from mvuav_ros.offline.evaluation.numbers import rms
from mvuav_ros.offline.evaluation.runway_runs import ALONG, FlownRunway, RunwayTask, fly_runway
from mvuav_ros.offline.report.model import Cell, Claim, Column, Figure, Section, Table
from mvuav_ros.offline.report.style import drawing, label
from mvuav_ros.offline.thesis.plan import ExperimentRunner, Plan, detector
from mvuav_ros.simulation.settings import RunwaySettings

FPS = 15.0
_THESIS = 'thesis'
_SCENES = {
    'low pass': {'motion': 'low_pass', 'start_distance': -20.0, 'speed': 25.0},
    'low pass, gain steps, 10 Hz camera': {
        'motion': 'low_pass',
        'start_distance': -20.0,
        'speed': 25.0,
        'gain_steps': 0.3,
        'camera_rate': 10.0,
    },
    'approach': {'motion': 'approach', 'start_distance': 450.0, 'speed': 30.0},
    'S-turn': {'motion': 's_turn', 'start_distance': 100.0, 'speed': 35.0},
}
"""Over the runway, as the thesis's camera was, and on the way to it."""
_PITCH = {'low_pass': 20.0, 'approach': 14.0, 's_turn': 24.0}


def runway_section(workshop: ExperimentRunner) -> tuple[Section, list[Claim]]:
    """Fly the scenes and show what was found."""
    flown = workshop.all_of(fly_runway, runway_tasks(workshop.plan))
    scenes = dict(zip(_SCENES, flown, strict=True))
    figures = [
        _scene_figure(f'figure_5_{12 + number}', f'Figure 5.{12 + number}: {name}', flight)
        for number, (name, flight) in enumerate(scenes.items())
    ]
    section = Section(
        'Runway lines',
        (
            "Simulated flights at the thesis's 320x240 with its rows (50 to 130), red channel and "
            'three peaks. The thesis shows real figures without truth and without numbers; here '
            'each found line is compared with the runway that was drawn.',
            f'A line counts as found when it passes within {DISTANCE_LIMIT:g} px of the true one '
            'at the middle of the rows, and differs from its direction by at most '
            f'{math.degrees(THETA_LIMIT):g}°. True edges are those of the pavement: the painted '
            'stripe lies a little inside, and '
            'a painted line has two sides, both of which are edges to the detector.',
        ),
        (_table(scenes), *figures),
    )
    return section, []


def runway_tasks(plan: Plan) -> list[RunwayTask]:
    """One flight for each scene, with three figures kept."""
    frames = plan.runway_frames
    kept = tuple(round(part * (frames - 1)) for part in (0.1, 0.5, 0.9))
    return [
        RunwayTask(
            RunwaySettings.from_mapping(
                {
                    'width': 320,
                    'height': 240,
                    'fps': FPS,
                    'frames': frames,
                    'seed': plan.seed,
                    'camera_pitch_deg': _PITCH[str(scene['motion'])],
                    **scene,
                }
            ),
            {_THESIS: detector()},
            kept,
        )
        for scene in _SCENES.values()
    ]


def _table(scenes: dict[str, FlownRunway]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for name, flight in scenes.items():
        run = flight.runs[_THESIS]
        for number, role in enumerate(ALONG):
            matches = run.of(number)
            visible = run.visible[number]
            rows.append(
                (
                    name,
                    role.name.lower().replace('_', ' '),
                    100.0 * len(matches) / visible if visible else math.nan,
                    rms(np.array([m.distance for m in matches])),
                    math.degrees(rms(np.array([m.dtheta for m in matches]))),
                    run.summary.rho_flags if number == 0 else None,
                    run.summary.theta_flags if number == 0 else None,
                )
            )
    return Table(
        'runway_truth',
        'What truth adds to Figures 5.12 to 5.15: lines found, and their error',
        (
            Column('scene'),
            Column('line'),
            Column('found', '% of frames', 1),
            Column('distance, RMS', 'px', 2),
            Column('direction, RMS', '°', 2),
            Column('rho flags'),
            Column('theta flags'),
        ),
        tuple(rows),
        (
            'Errors are those of the lines found, at the middle of the rows. Flags are of all '
            "lines of the scene together; the thesis's counts are not available to us.",
        ),
    )


def _scene_figure(key: str, title: str, flight: FlownRunway) -> Figure:
    run = flight.runs[_THESIS]
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
            'Solid green: lines believed; dashed: held by the rho/theta correction, in the colour '
            'of their flags. Dotted blue on white: the true edges and centreline. Brackets: the '
            "rows searched. The thesis's own figures are not available to us.",
        ),
    )

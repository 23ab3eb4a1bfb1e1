"""Fig. 4.30 and Figures 5.12 to 5.15: runway images with lines, and how right the lines are."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from mvuav_ros.offline.evaluation.line_errors import DISTANCE_LIMIT, THETA_LIMIT
from mvuav_ros.offline.evaluation.numbers import rms
from mvuav_ros.offline.evaluation.runway_runs import (
    ALONG,
    FlownRunway,
    RunwayRun,
    RunwayTask,
    fly_runway,
)
from mvuav_ros.offline.report.comparison import SHIPPED, Compared
from mvuav_ros.offline.report.model import Cell, Claim, Column, Figure, Section, Table
from mvuav_ros.offline.report.style import drawing, label
from mvuav_ros.offline.thesis import known
from mvuav_ros.offline.thesis.plan import ExperimentRunner, Plan, thesis_detector
from mvuav_ros.offline.thesis.runway_stages import THESIS_YAML
from mvuav_ros.offline.thesis.videos import LOW_PASS
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.simulation.settings import RunwaySettings
from mvuav_ros.vision.runway.statistics import LineSummary

APPROACH = 'mode approach'
_SCENES = {
    'low pass': LOW_PASS,
    'low pass, gain steps, 10 Hz camera': {**LOW_PASS, 'gain_steps': 0.3, 'camera_rate': 10.0},
    'approach': {
        'motion': 'approach',
        'start_distance': 130.0,
        'speed': 30.0,
        'camera_pitch_deg': 14.0,
    },
    'S-turn': {
        'motion': 's_turn',
        'start_distance': 100.0,
        'speed': 35.0,
        'camera_pitch_deg': 24.0,
    },
}
"""Over the runway, as the thesis's camera was, and on the way to it."""
FIGURE_SCENE = 'low pass, gain steps, 10 Hz camera'
"""Beside Fig. 4.30: the thesis's camera gave 10 images a second and changed its gain by itself."""
FIRST_JUDGED = 25
"""Frames in which mode approach may still be looking."""
RIGHT_LIMIT, WRONG_LIMIT = 60.0, 2.0
"""Percent of frames: both edges right at least, confident and wrong at most."""


def runway_section(runner: ExperimentRunner) -> tuple[Section, list[Claim]]:
    """Fly the scenes and show what was found."""
    flown = runner.all_of(fly_runway, runway_tasks(runner.plan))
    scenes = dict(zip(_SCENES, flown, strict=True))
    figures = [
        _scene_figure(f'figure_5_{12 + number}', f'Figure 5.{12 + number}: {name}', flight)
        for number, (name, flight) in enumerate(scenes.items())
    ]
    section = Section(
        'Runway lines',
        (
            f'Simulated flights of {runner.plan.runway_frames} frames at {known.RUNWAY_FPS:g} '
            f'frames/s and 320x240, as in the thesis, with {THESIS_YAML}, with our defaults '
            f'({SHIPPED}) and in mode approach. The images of the thesis are of real flights, '
            'without truth; here each found line is compared with the runway that was drawn.',
            f'A line counts as found when it passes within {DISTANCE_LIMIT:g} px of the true one '
            'at the middle of the rows, and differs from its direction by at most '
            f'{math.degrees(THETA_LIMIT):g}°. True edges are those of the pavement: the painted '
            'stripe lies a little inside, and '
            'a painted line has two sides, both of which are edges to the detector.',
        ),
        (
            table_5_6(),
            figure_4_30(scenes[FIGURE_SCENE]),
            flags_table(scenes),
            found_table(scenes),
            approach_table(scenes),
            *figures,
        ),
    )
    return section, approach_claims(scenes)


def runway_tasks(plan: Plan) -> list[RunwayTask]:
    """One flight for each scene, with three figures kept."""
    frames = plan.runway_frames
    kept = tuple(round(part * (frames - 1)) for part in (0.1, 0.5, 0.9))
    detectors = {
        THESIS_YAML: thesis_detector(),
        SHIPPED: RunwayDetectorParameters(),
        APPROACH: RunwayDetectorParameters(mode='approach'),
    }
    return [
        RunwayTask(
            RunwaySettings.from_mapping(
                {
                    'width': 320,
                    'height': 240,
                    'fps': known.RUNWAY_FPS,
                    'frames': frames,
                    'seed': plan.seed,
                    **scene,
                }
            ),
            detectors,
            kept,
        )
        for scene in _SCENES.values()
    ]


def table_5_6() -> Table:
    """Which flights are used for what; the thesis's table has no numbers."""
    return Table(
        'table_5_6',
        'Table 5.6: the trials used for evaluation, runway',
        (Column('comparison'), Column('thesis'), Column('here')),
        (
            ('profiler (Table 5.7)', 'trials 1, 2', 'a low pass'),
            (
                'visual examination (Figures 5.12 to 5.15)',
                'trials 1, 2',
                ', '.join(_SCENES),
            ),
        ),
    )


def figure_4_30(flight: FlownRunway) -> Table:
    """The result section of the thesis's GUI, with ours beside it."""
    numbers = {name: gui_numbers(flight.runs[name]) for name in (THESIS_YAML, SHIPPED)}
    rows: list[tuple[Cell, ...]] = []
    for cell in known.FIGURE_4_30:
        ours, shipped = (numbers[name][cell.row] for name in (THESIS_YAML, SHIPPED))
        digits = 0 if 'flag' in cell.row else None
        if cell.row.endswith('mean'):
            rows.append((cell.row, cell.text, ours, shipped))
            continue
        rows.append(
            (
                cell.row,
                cell.text,
                Compared(ours, cell.value, digits=digits),
                Compared(shipped, cell.value, SHIPPED, digits=digits),
            )
        )
    return Table(
        'figure_4_30',
        "Fig. 4.30: the results of the thesis's GUI",
        (
            Column('result'),
            Column('thesis'),
            Column(f'here, {THESIS_YAML}', '', 4),
            Column(SHIPPED, '', 4),
        ),
        tuple(rows),
        (
            f'Scene "{FIGURE_SCENE}": another flight than the one in the thesis, which is not to '
            'be had, so that better and worse say as much of the flight as of the scheme. Fewer '
            'flags and smaller deviations are better; a mean is neither. Rho in px, theta in rad. '
            'A flag counts once for a frame, whichever of its lines raised it.',
            jitter_text(flight),
            'The picture shows 2 for the number of peaks and results of three lines; its text '
            'has three peaks. A neighbourhood of 11 x 11 and a threshold of 1, as in the picture.',
        ),
    )


def jitter_text(flight: FlownRunway) -> str:
    """How far directions are off, beside the threshold of the theta flag."""
    parts = []
    for name in (THESIS_YAML, SHIPPED):
        errors = np.degrees([match.dtheta for match in flight.runs[name].matches])
        parts.append(f'{rms(errors):.1f}° RMS ({name})')
    limit = thesis_detector().theta_error_threshold_deg
    return (
        f'The theta flag is up where a line turns by more than {limit:g}° from one frame to the '
        'next. The directions of the lines that are found here, two sides of a painted stripe in '
        f'a slice of 81 rows, are themselves off by {" and ".join(parts)}.'
    )


def gui_numbers(run: RunwayRun) -> dict[str, float]:
    """A detector's statistics under the names of Fig. 4.30's cells."""
    summary = run.summary
    scale = 150.0 / summary.frames if summary.frames else math.nan
    numbers = {
        'Rho flag, frames of 150': scale * summary.rho_flags,
        'Theta flag, frames of 150': scale * summary.theta_flags,
        'Main flag, frames of 150': scale * summary.corrected,
    }
    for number, line in enumerate(summary.lines, 1):
        numbers |= _line_numbers(number, line)
    return numbers


def _line_numbers(number: int, line: LineSummary) -> dict[str, float]:
    return {
        f'Rho {number}, mean': line.rho_mean,
        f'Rho {number}, standard deviation': line.rho_std,
        f'Theta {number}, mean': line.theta_mean,
        f'Theta {number}, standard deviation': line.theta_std,
    }


def flags_table(scenes: Mapping[str, FlownRunway]) -> Table:
    """Frames with a flag, in all and by line."""
    rows: list[tuple[Cell, ...]] = []
    for scene, flight in scenes.items():
        for name in (THESIS_YAML, SHIPPED):
            summary = flight.runs[name].summary
            frames = summary.frames
            lines = ', '.join(f'{line.corrected}' for line in summary.lines)
            rows.append(
                (
                    scene,
                    name,
                    *(
                        f'{count} / {frames}'
                        for count in (summary.rho_flags, summary.theta_flags, summary.corrected)
                    ),
                    lines,
                )
            )
    return Table(
        'runway_flags',
        'Frames with a flag, as the GUI counts them',
        (
            Column('scene'),
            Column('by'),
            Column('rho'),
            Column('theta'),
            Column('combined'),
            Column('combined, by line'),
        ),
        tuple(rows),
        (_flag_text(scenes),),
    )


def _flag_text(scenes: Mapping[str, FlownRunway]) -> str:
    fewer = sum(
        flight.runs[SHIPPED].summary.corrected < flight.runs[THESIS_YAML].summary.corrected
        for flight in scenes.values()
    )
    return f'The defaults raise a flag in fewer frames on {fewer} of {len(scenes)} scenes.'


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


def _scene_figure(key: str, title: str, flight: FlownRunway) -> Figure:
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

"""Fig. 4.30 and Figures 5.12 to 5.15: the GUI's results and images of four runway scenes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from mvuav_ros.offline.evaluation.line_errors import DISTANCE_LIMIT, THETA_LIMIT
from mvuav_ros.offline.evaluation.numbers import rms
from mvuav_ros.offline.evaluation.runway_runs import (
    FlownRunway,
    RunwayRun,
    RunwayTask,
)
from mvuav_ros.offline.report.comparison import SHIPPED, Compared
from mvuav_ros.offline.report.model import Cell, Claim, Column, Section, Table
from mvuav_ros.offline.thesis import known
from mvuav_ros.offline.thesis.plan import Plan, thesis_detector
from mvuav_ros.offline.thesis.runway_stages import THESIS_YAML
from mvuav_ros.offline.thesis.runway_truth import (
    APPROACH,
    approach_claims,
    approach_table,
    found_table,
    scene_figure,
)
from mvuav_ros.offline.thesis.videos import LOW_PASS
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.simulation.settings import RunwaySettings
from mvuav_ros.vision.runway.statistics import LineSummary

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


def runway_section(plan: Plan, flown: Sequence[FlownRunway]) -> tuple[Section, list[Claim]]:
    """Show what was found on the scenes."""
    scenes = dict(zip(_SCENES, flown, strict=True))
    figures = [
        scene_figure(f'figure_5_{12 + number}', f'Figure 5.{12 + number}: {name}', flight)
        for number, (name, flight) in enumerate(scenes.items())
    ]
    section = Section(
        'Runway lines',
        (
            f'Simulated flights of {plan.runway_frames} frames at {known.RUNWAY_FPS:g} '
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

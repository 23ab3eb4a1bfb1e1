"""Fig. 4.30 and Figures 5.12 to 5.15: the GUI's results and images of four runway scenes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from mvuav_ros.offline.evaluation.metrics import DISTANCE_LIMIT, THETA_LIMIT, rms
from mvuav_ros.offline.report import Cell, Section, Table
from mvuav_ros.parameters.declaration import Value
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_thesis import known
from mvuav_thesis.comparison import METHOD, SHIPPED, Claim, Compared
from mvuav_thesis.plan import Plan, thesis_detector
from mvuav_thesis.runway_runs import FlownRunway, RunwayRun, RunwayTask
from mvuav_thesis.runway_stages import THESIS_YAML
from mvuav_thesis.runway_truth import (
    APPROACH,
    approach_claims,
    approach_table,
    found_table,
    scene_figure,
)
from mvuav_thesis.videos import LOW_PASS

_SCENES: Mapping[str, Mapping[str, Value]] = {
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
_COMPARED = {THESIS_YAML: METHOD, SHIPPED: SHIPPED}
"""What is held against the thesis's numbers, and by what it was made."""


def runway_section(plan: Plan, flown: Sequence[FlownRunway]) -> tuple[Section, list[Claim]]:
    """Show what was found on the scenes."""
    scenes = dict(zip(_SCENES, flown, strict=True))
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
            *(
                scene_figure(f'figure_5_{number}', f'Figure 5.{number}: {name}', flight)
                for number, (name, flight) in enumerate(scenes.items(), 12)
            ),
        ),
    )
    return section, approach_claims(scenes)


def runway_tasks(plan: Plan) -> list[RunwayTask]:
    """One flight for each scene, with three figures kept."""
    kept = tuple(round(part * (plan.runway_frames - 1)) for part in (0.1, 0.5, 0.9))
    detectors = {
        THESIS_YAML: thesis_detector(),
        SHIPPED: RunwayDetectorParameters(),
        APPROACH: RunwayDetectorParameters(mode='approach'),
    }
    return [RunwayTask(plan.runway(scene), detectors, kept) for scene in _SCENES.values()]


def table_5_6() -> Table:
    """Which flights are used for what; the thesis's table has no numbers."""
    return Table.of(
        'table_5_6',
        'Table 5.6: the trials used for evaluation, runway',
        'comparison | thesis | here',
        (
            ('profiler (Table 5.7)', 'trials 1, 2', 'a low pass'),
            ('visual examination (Figures 5.12 to 5.15)', 'trials 1, 2', ', '.join(_SCENES)),
        ),
    )


def figure_4_30(flight: FlownRunway) -> Table:
    """The result section of the thesis's GUI, with ours beside it."""
    numbers = {by: gui_numbers(flight.runs[by]) for by in _COMPARED}
    rows = []
    for cell in known.FIGURE_4_30:
        ours: list[Cell] = [numbers[by][cell.row] for by in _COMPARED]
        if not cell.row.endswith('mean'):
            digits = 0 if 'flag' in cell.row else None
            ours = [
                Compared(numbers[name][cell.row], cell.value, by, digits=digits)
                for name, by in _COMPARED.items()
            ]
        rows.append((cell.row, cell.text, *ours))
    errors = (
        f'{rms(np.degrees([match.dtheta for match in flight.runs[name].matches])):.1f}° RMS '
        f'({name})'
        for name in _COMPARED
    )
    return Table.of(
        'figure_4_30',
        "Fig. 4.30: the results of the thesis's GUI",
        f'result | thesis | here, {THESIS_YAML} .4 | {SHIPPED} .4',
        rows,
        f'Scene "{FIGURE_SCENE}": another flight than the one in the thesis, which is not to '
        'be had, so that better and worse say as much of the flight as of the scheme. Fewer '
        'flags and smaller deviations are better; a mean is neither. Rho in px, theta in rad. '
        'A flag counts once for a frame, whichever of its lines raised it.',
        f'The theta flag is up where a line turns by more than '
        f'{thesis_detector().theta_error_threshold_deg:g}° from one frame to the '
        'next. The directions of the lines that are found here, two sides of a painted stripe in '
        f'a slice of 81 rows, are themselves off by {" and ".join(errors)}.',
        'The picture shows 2 for the number of peaks and results of three lines; its text '
        'has three peaks. A neighbourhood of 11 x 11 and a threshold of 1, as in the picture.',
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
        numbers[f'Rho {number}, mean'] = line.rho_mean
        numbers[f'Rho {number}, standard deviation'] = line.rho_std
        numbers[f'Theta {number}, mean'] = line.theta_mean
        numbers[f'Theta {number}, standard deviation'] = line.theta_std
    return numbers


def flags_table(scenes: Mapping[str, FlownRunway]) -> Table:
    """Frames with a flag, in all and by line."""
    rows = []
    fewer = 0
    for scene, flight in scenes.items():
        summaries = {name: flight.runs[name].summary for name in _COMPARED}
        fewer += summaries[SHIPPED].corrected < summaries[THESIS_YAML].corrected
        for name, summary in summaries.items():
            counts = (summary.rho_flags, summary.theta_flags, summary.corrected)
            flags = [f'{count} / {summary.frames}' for count in counts]
            lines = ', '.join(f'{line.corrected}' for line in summary.lines)
            rows.append((scene, name, *flags, lines))
    return Table.of(
        'runway_flags',
        'Frames with a flag, as the GUI counts them',
        'scene | by | rho | theta | combined | combined, by line',
        rows,
        f'The defaults raise a flag in fewer frames on {fewer} of {len(scenes)} scenes.',
    )

"""Fig. 4.30, Figures 5.12 to 5.15: four runway scenes, their lines against truth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.offline.evaluation.metrics import (
    ALONG,
    DISTANCE_LIMIT,
    THETA_LIMIT,
    LineErrors,
    LineMatch,
    TrueLine,
    rms,
)
from mvuav_ros.offline.report import Cell, Figure, Section, Table
from mvuav_ros.offline.report_figures import drawing, label
from mvuav_ros.parameters.declaration import Value
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.simulation.runway_flight import LineTruth, RunwayFlight
from mvuav_ros.simulation.settings import RunwaySettings
from mvuav_ros.vision.approach.approach_detector import ApproachDetector
from mvuav_ros.vision.runway.debug_images import draw_overlay
from mvuav_ros.vision.runway.detector import RunwayDetector
from mvuav_ros.vision.runway.normal_form import NormalForm
from mvuav_ros.vision.runway.results import RunwayResult
from mvuav_ros.vision.runway.statistics import RunwayStatistics
from mvuav_thesis import known
from mvuav_thesis.comparison import METHOD, SHIPPED, Claim, Compared
from mvuav_thesis.plan import Plan, thesis_detector, words
from mvuav_thesis.runway_stages import THESIS_YAML
from mvuav_thesis.stages import LOW_PASS


@dataclass(frozen=True)
class RunwayTask:
    """A flight, the parameters of each detector by name, and whose images to keep when."""

    flight: RunwaySettings
    detectors: Mapping[str, RunwayDetectorParameters]
    images: Sequence[int] = ()
    row: float = 90.0


class LineImage(NamedTuple):
    """A frame's time (s), the detector's overlay, and the true lines' segments, (k, 4) px."""

    time: float
    overlay: NDArray[np.uint8]
    segments: NDArray[np.float64]


@dataclass(eq=False)
class RunwayRun(LineErrors):
    """One detector's results on a flight.

    Attributes:
        right: by frame, whether both edges were found where they are, each in its own row of the
            result (mode approach distinguishes them); None where an edge was not on the frame.
        wrong: by frame, whether a row said that it holds an edge and held none.
        images: those asked for.
        statistics: of its lines, as the node has them.
    """

    right: list[bool | None] = field(default_factory=list)
    wrong: list[bool] = field(default_factory=list)
    images: list[LineImage] = field(default_factory=list)
    statistics: RunwayStatistics = field(default_factory=RunwayStatistics)

    def add(self, found: Sequence[NormalForm], true: Sequence[TrueLine]) -> list[LineMatch]:
        """Hold the first two rows, the edges in mode approach, against the true edges as well."""
        matches = super().add(found, true)
        own = [any((m.found, m.true) == (edge, edge) for m in matches) for edge in (0, 1)]
        said = [math.isfinite(line.rho) for line in found[:2]]
        judged = all(math.isfinite(line.line.rho) for line in true[:2])
        self.right.append(all(own) if judged else None)
        self.wrong.append(judged and any(s and not o for s, o in zip(said, own, strict=False)))
        return matches


@dataclass(frozen=True, eq=False)
class FlownRunway:
    """All detectors' results on one flight."""

    settings: RunwaySettings
    runs: Mapping[str, RunwayRun]


def fly_runway(task: RunwayTask) -> FlownRunway:
    """Draw every frame once and show it to every detector."""
    flight = RunwayFlight(task.flight)
    detectors = {
        name: (ApproachDetector if p.mode == 'approach' else RunwayDetector)(p)
        for name, p in task.detectors.items()
    }
    runs = {name: RunwayRun() for name in detectors}
    for index in flight.indices:
        frame = flight.frame(index)
        image = frame.image.bgr()
        lines = [frame.truth.line(role) for role in ALONG]
        true = [_at_row(line, task.row) for line in lines]
        for name, detector in detectors.items():
            result = detector.process(image, frame.stamp_ns)
            runs[name].statistics.add(result.lines)
            runs[name].add([NormalForm(line.rho, line.theta) for line in result.lines], true)
            if index in task.images:
                segments = np.array([(t.x1, t.y1, t.x2, t.y2) for t in lines if t.visible])
                shown = draw_overlay(result) if isinstance(result, RunwayResult) else image
                # Red first, as figures want it.
                overlay = np.asarray(cv2.cvtColor(shown, cv2.COLOR_BGR2RGB), np.uint8)
                kept = LineImage(flight.time(index), overlay, segments.reshape(-1, 4))
                runs[name].images.append(kept)
    return FlownRunway(task.flight, runs)


def _at_row(line: LineTruth, row: float) -> TrueLine:
    """The line with its point in a row; NaN where it does not cross the row on the frame."""
    if not line.visible or not min(line.y1, line.y2) <= row <= max(line.y1, line.y2):
        return TrueLine(NormalForm(math.nan, math.nan), (math.nan, math.nan))
    column = (line.rho - row * math.sin(line.theta)) / math.cos(line.theta)
    return TrueLine(NormalForm(line.rho, line.theta), (column, row))


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
        'flags and smaller deviations are better; a mean is neither. Rho in px, in the thesis of '
        'the line in the slice, here on the whole frame; theta in rad. '
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
    summary = run.statistics.summary()
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
        summaries = {name: flight.runs[name].statistics.summary() for name in _COMPARED}
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

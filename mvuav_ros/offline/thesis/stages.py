"""Table 5.2: time per stage of the marker programs over 150 frames of trial 1.

The stages are timed by calling the programs' own functions one after the other on the same frames;
the total is the program's own call and the reading of the video. What the stages leave is the rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from mvuav_ros.offline.evaluation.stopwatch import Stopwatch
from mvuav_ros.offline.report.comparison import SHIPPED, Compared
from mvuav_ros.offline.report.model import Cell, Column, Table
from mvuav_ros.offline.thesis import known
from mvuav_ros.offline.thesis.plan import PROGRAM_OF, Plan, tracker
from mvuav_ros.offline.thesis.statements import sum_text
from mvuav_ros.offline.thesis.videos import read_avi, write_avi
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.recordings.sources.frame import Frame
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.grouping import area_fits, bright_pixels, group_pixels
from mvuav_ros.vision.markers.labelling import label_five
from mvuav_ros.vision.markers.motion import Motion
from mvuav_ros.vision.markers.results import TANKER_LABELS, Cluster, Window
from mvuav_ros.vision.markers.thesis_tracker import WHOLE_FRAMES, measure_window
from mvuav_ros.vision.markers.tracker import MarkerTracker
from mvuav_ros.vision.point_operations import Mask, threshold

WHOLE = 'whole'
READING, PREPARING, SCANNING, WINDOWS, CENTROIDS, NAMING, REST, TOTAL = known.STAGES
PARAMETERS: Mapping[str, MarkerTrackerParameters] = {
    known.PROGRAMS[0]: tracker(mode='detect'),
    **{name: tracker(mode='track', prediction=method) for name, method in PROGRAM_OF.items()},
    SHIPPED: MarkerTrackerParameters(),
}


@dataclass
class ProgramTimes:
    """A program's stages: times of each frame, and how often the innermost work was done."""

    watch: Stopwatch = field(default_factory=Stopwatch)
    executions: dict[str, int] = field(default_factory=dict)

    def count(self, stage: str, number: int) -> None:
        """Add to a stage's executions."""
        self.executions[stage] = self.executions.get(stage, 0) + number

    def seconds(self) -> dict[str, float]:
        """Each row of the table; NaN is never in it, a stage that does not run is missing."""
        watch = self.watch
        stages = {name: watch.total_s(name) for name in watch.stages if name != WHOLE}
        total = watch.total_s(WHOLE) + stages[READING]
        return {**stages, REST: total - sum(stages.values()), TOTAL: total}


def time_programs(images: Sequence[tuple[Image, int]], plan: Plan) -> dict[str, ProgramTimes]:
    """Each program over the video of trial 1."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / 'trial_1.avi'
        write_avi(path, (image.bgr() for image, _ in images), known.TRIAL_FPS)
        return {name: _time(name, path, plan.passes) for name in PARAMETERS}


def _time(name: str, path: Path, passes: int) -> ProgramTimes:
    times = ProgramTimes()
    for _ in range(passes):
        frames, reading = read_avi(path, known.TRIAL_FPS)
        times.executions = {}
        for number, seconds in enumerate(reading):
            times.watch.note(READING, number, seconds)
        times.count(READING, 1)
        times.count(TOTAL, 1)
        program = MarkerTracker(PARAMETERS[name])
        for number, frame in enumerate(frames):
            times.watch.time(WHOLE, number, program.process, frame.image, frame.stamp_ns)
        if name != SHIPPED:
            _time_stages(frames, PARAMETERS[name], times)
    return times


def _time_stages(
    frames: Sequence[Frame], parameters: MarkerTrackerParameters, times: ProgramTimes
) -> None:
    """One pass of the program's functions, one after the other."""
    motions = [Motion() for _ in TANKER_LABELS]
    for number, frame in enumerate(frames):
        time = (frame.stamp_ns - frames[0].stamp_ns) * 1e-9
        if parameters.mode == 'detect' or number < WHOLE_FRAMES:
            named = _whole_frame(number, frame.image, parameters, times)
        else:
            named = times.watch.time(
                WINDOWS, number, _windows, motions, time, frame.image, parameters
            )
            times.count(WINDOWS, _scanned(motions, time, frame.image, parameters))
        for motion, light in zip(motions, named, strict=True):
            motion.add(time, light.x, light.y)


def _whole_frame(
    number: int, image: Image, parameters: MarkerTrackerParameters, times: ProgramTimes
) -> list[Cluster]:
    """Appendix A's stages on one frame."""
    watch = times.watch
    mask = watch.time(PREPARING, number, _prepare, image, parameters)
    x, y = watch.time(SCANNING, number, bright_pixels, mask)
    groups = watch.time(CENTROIDS, number, group_pixels, x, y, parameters.grouping_distance)
    groups = [group for group in groups if area_fits(group.area, parameters)]
    order = watch.time(NAMING, number, label_five, groups)
    for stage, executions in (
        (PREPARING, 1),
        (SCANNING, mask.size),
        (CENTROIDS, len(x)),
        (NAMING, 1),
    ):
        times.count(stage, executions)
    return [groups[i] for i in order]


def _prepare(image: Image, parameters: MarkerTrackerParameters) -> Mask:
    return threshold(image.seen_in(parameters.channel).gray(), parameters.threshold)


def _windows(
    motions: Sequence[Motion], time: float, image: Image, parameters: MarkerTrackerParameters
) -> list[Cluster]:
    """Predict, cut, threshold and take the moments of five windows."""
    lights = []
    for motion in motions:
        x, y = motion.predict(time, parameters.prediction)
        window = Window.around(x, y, parameters.search_radius, (image.width, image.height))
        light = measure_window(image, window, parameters)
        # Of an undisturbed flight: every light is in its window.
        assert light is not None
        lights.append(light)
    return lights


def _scanned(
    motions: Sequence[Motion], time: float, image: Image, parameters: MarkerTrackerParameters
) -> int:
    """Pixels of the five windows."""
    radius, size = parameters.search_radius, (image.width, image.height)
    windows = [
        Window.around(*motion.predict(time, parameters.prediction), radius, size)
        for motion in motions
    ]
    return sum((w.x1 - w.x0 + 1) * (w.y1 - w.y0 + 1) for w in windows)


def table_5_2(times: Mapping[str, ProgramTimes], plan: Plan) -> Table:
    """The thesis's rows and columns, each with ours beside it."""
    columns = [Column('process')]
    for program in known.PROGRAMS:
        columns += [
            Column(f'{program}: thesis', 's'),
            Column(f'{program}: here', 's', 4),
            Column(f'{program}: executions, thesis'),
            Column(f'{program}: executions, here'),
        ]
    seconds = {program: times[program].seconds() for program in known.PROGRAMS}
    rows: list[tuple[Cell, ...]] = []
    for stage in known.STAGES:
        row: list[Cell] = [stage]
        for program in known.PROGRAMS:
            printed = known.cell('table_5_2', stage, f'{program}, time')
            ours = seconds[program].get(stage)
            row += [printed.text, ours if stage == REST else _compared(ours, printed)]
            row.append(known.cell('table_5_2', stage, f'{program}, executions').text)
            row.append(times[program].executions.get(stage))
        rows.append(tuple(row))
    return Table(
        'table_5_2',
        'Table 5.2: time per stage, markers',
        tuple(columns),
        tuple(rows),
        (
            f'{plan.trial_frames} frames of trial 1 from an uncompressed AVI file of colour '
            f'frames of 640x480; sums of the least of {plan.passes} passes over each frame. The '
            "thesis's times are of MATLAB under its profiler on its machine. The rest is "
            'what the stages leave of the total: near zero it is noise, and it is not compared.',
            'Here a window is thresholded, scanned and its centroid taken in one stage, "Scanning '
            'for Estimation", so that pre-processing and centroids run on the whole frames only. '
            'The executions of "Centroid Calculation" are the bright pixels, which the size of a '
            'light decides: they are not compared.',
            *(
                sum_text(printed[-1], printed[:-1], f'Table 5.2 ({program})')
                for program, printed in _printed_columns().items()
            ),
            f'The node as shipped takes {times[SHIPPED].seconds()[TOTAL]:.3f} s in all.',
        ),
    )


def _printed_columns() -> dict[str, list[float]]:
    """The thesis's times by program, without the stages that do not run."""
    columns = {}
    for program in known.PROGRAMS:
        cells = [known.cell('table_5_2', stage, f'{program}, time') for stage in known.STAGES]
        columns[program] = [cell.value for cell in cells if cell.text != 'N/A']
    return columns


def _compared(ours: float | None, printed: known.Known) -> Cell:
    if ours is None or printed.text == 'N/A':
        return 'N/A' if ours is None else ours
    return Compared(ours, printed.value, is_bound=printed.is_bound)

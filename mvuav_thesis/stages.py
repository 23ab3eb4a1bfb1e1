"""Table 5.2: time by stage of the marker programs, over videos like those of the thesis."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar, TypeVarTuple

import cv2

from mvuav_ros.messages.images import Frame
from mvuav_ros.offline.report import Cell, Table
from mvuav_ros.parameters.declaration import Value
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.simulation.runway_flight import RunwayFlight
from mvuav_ros.simulation.settings import TRIALS
from mvuav_ros.simulation.tanker_flight import TankerFlight
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.lights import Detection, area_fits, group_mask
from mvuav_ros.vision.markers.marker_results import TANKER_LABELS, Window
from mvuav_ros.vision.markers.thesis_tracker import WHOLE_FRAMES, Motion, label_five, measure_window
from mvuav_ros.vision.markers.tracker import MarkerTracker
from mvuav_ros.vision.point_operations import Mask, Pixels, threshold
from mvuav_thesis import known
from mvuav_thesis.comparison import SHIPPED, Compared
from mvuav_thesis.plan import PROGRAM_OF, Plan, tracker

ResultT = TypeVar('ResultT')
Given = TypeVarTuple('Given')


class Stopwatch:
    """Times stages of a frame; several passes over the same frames, of which the least counts.

    On a machine with other work the least time is the one that says how long the code takes.
    """

    def __init__(self) -> None:
        self._times: dict[str, dict[int, float]] = {}

    def time(
        self, stage: str, frame: int, work: Callable[[*Given], ResultT], *given: *Given
    ) -> ResultT:
        """Call the work with what is given and note how long it took."""
        start = time.perf_counter()
        result = work(*given)
        self.note(stage, frame, time.perf_counter() - start)
        return result

    def note(self, stage: str, frame: int, elapsed: float) -> None:
        """Take in a time (s) that was measured elsewhere."""
        times = self._times.setdefault(stage, {})
        times[frame] = min(elapsed, times.get(frame, elapsed))

    @property
    def stages(self) -> list[str]:
        """In order of first use."""
        return list(self._times)

    def frames(self, stage: str) -> int:
        """Frames in which the stage ran."""
        return len(self._times[stage])

    def total_s(self, stage: str) -> float:
        """Sum over the frames, s."""
        return sum(self._times[stage].values())


_UNCOMPRESSED = 'RGBA'
LOW_PASS: Mapping[str, Value] = {
    'motion': 'low_pass',
    'start_distance': -20.0,
    'speed': 25.0,
    'camera_pitch_deg': 20.0,
}


def trial_images(plan: Plan, number: int) -> list[tuple[Image, int]]:
    """The frames of a trial (1 to 4) and their stamps."""
    flight = TankerFlight(plan.trial(TRIALS[number - 1]))
    return [(frame.image, frame.stamp_ns) for frame in flight]


def runway_images(plan: Plan) -> list[Pixels]:
    """The frames of a low pass over the runway, blue first."""
    return [frame.image.bgr() for frame in RunwayFlight(plan.runway(LOW_PASS))]


def write_avi(path: Path, images: Iterable[Pixels], fps: float) -> None:
    """Write colour frames without compression, as the thesis's file of 150 MB."""
    writer: cv2.VideoWriter | None = None
    for image in images:
        if writer is None:
            size = (image.shape[1], image.shape[0])
            writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*_UNCOMPRESSED), fps, size)
        writer.write(image)
    if writer is not None:
        writer.release()


def read_avi(path: Path, fps: float) -> tuple[list[Frame], list[float]]:
    """Every frame of a video, and the time that reading each took, s.

    With OpenCV, which wrote it: so that the report needs no other library for videos.
    """
    frames: list[Frame] = []
    taken: list[float] = []
    capture = cv2.VideoCapture(str(path))
    while True:
        start = time.perf_counter()
        ok, pixels = capture.read()
        if not ok:
            capture.release()
            return frames, taken
        taken.append(time.perf_counter() - start)
        stamp_ns = round(len(frames) * 1e9 / fps)
        frames.append(Frame(stamp_ns, 'camera', Image(pixels, 'bgr8')))


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
    executions: Counter[str] = field(default_factory=Counter)

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
        times.executions = Counter({READING: 1, TOTAL: 1})
        for number, seconds in enumerate(reading):
            times.watch.note(READING, number, seconds)
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
            given = (motions, time, frame.image, parameters)
            named = times.watch.time(WINDOWS, number, _measure_windows, *given)
            windows = _windows(*given)
            times.executions[WINDOWS] += sum((w.x1 - w.x0 + 1) * (w.y1 - w.y0 + 1) for w in windows)
        for motion, light in zip(motions, named, strict=True):
            motion.add(time, light.x, light.y)


def _whole_frame(
    number: int, image: Image, parameters: MarkerTrackerParameters, times: ProgramTimes
) -> list[Detection]:
    """Appendix A's stages on one frame."""
    watch = times.watch
    mask = watch.time(PREPARING, number, _prepare, image, parameters)
    bright = watch.time(SCANNING, number, cv2.findNonZero, mask)
    found = watch.time(CENTROIDS, number, group_mask, mask, parameters.grouping_distance)
    groups = [Detection(*group) for group in found.tolist() if area_fits(group[2], parameters)]
    order = watch.time(NAMING, number, label_five, groups)
    times.executions.update({PREPARING: 1, SCANNING: mask.size, CENTROIDS: len(bright), NAMING: 1})
    return [groups[i] for i in order]


def _prepare(image: Image, parameters: MarkerTrackerParameters) -> Mask:
    return threshold(image.seen_in(parameters.channel).gray(), parameters.threshold)


def _windows(
    motions: Sequence[Motion], time: float, image: Image, parameters: MarkerTrackerParameters
) -> list[Window]:
    """Where the markers are searched."""
    radius, size = parameters.search_radius, (image.width, image.height)
    return [
        Window.around(*motion.predict(time, parameters.prediction), radius, size)
        for motion in motions
    ]


def _measure_windows(
    motions: Sequence[Motion], time: float, image: Image, parameters: MarkerTrackerParameters
) -> list[Detection]:
    """Predict, cut, threshold and take the moments of five windows."""
    lights = []
    for window in _windows(motions, time, image, parameters):
        light = measure_window(image, window, parameters)
        # Of an undisturbed flight: every light is in its window.
        assert light is not None
        lights.append(light)
    return lights


def table_5_2(times: Mapping[str, ProgramTimes], plan: Plan) -> Table:
    """The thesis's rows and columns, each with ours beside it."""
    parts = ('thesis [s]', 'here [s] .4', 'executions, thesis', 'executions, here')
    heads = [f'{program}: {part}' for program in known.PROGRAMS for part in parts]
    seconds = {program: times[program].seconds() for program in known.PROGRAMS}
    rows = []
    for stage in known.STAGES:
        row: list[Cell] = [stage]
        for program in known.PROGRAMS:
            printed = known.cell('table_5_2', stage, f'{program}, time')
            ours = seconds[program].get(stage)
            row += [printed.text, ours if stage == REST else _compared(ours, printed)]
            row.append(known.cell('table_5_2', stage, f'{program}, executions').text)
            row.append(times[program].executions.get(stage))
        rows.append(row)
    return Table.of(
        'table_5_2',
        'Table 5.2: time per stage, markers',
        ' | '.join(['process', *heads]),
        rows,
        f'{plan.trial_frames} frames of trial 1 from an uncompressed AVI file of colour '
        f'frames of 640x480; sums of the least of {plan.passes} passes over each frame. The '
        "thesis's times are of MATLAB under its profiler on its machine. The rest is "
        'what the stages leave of the total: near zero it is noise, and it is not compared.',
        'Here a window is thresholded, scanned and its centroid taken in one stage, "Scanning '
        'for Estimation", so that pre-processing and centroids run on the whole frames only. '
        'The executions of "Centroid Calculation" are the bright pixels, which the size of a '
        'light decides: they are not compared.',
        *map(_sum_text, known.PROGRAMS),
        f'The node as shipped takes {times[SHIPPED].seconds()[TOTAL]:.3f} s in all.',
    )


def _compared(ours: float | None, printed: known.Known) -> Cell:
    if ours is None or printed.text == 'N/A':
        return 'N/A' if ours is None else ours
    return Compared(ours, printed.value, is_bound=printed.is_bound)


def _sum_text(program: str) -> str:
    """Of the stages that run."""
    cells = [known.cell('table_5_2', stage, f'{program}, time') for stage in known.STAGES]
    return sum_text([c.value for c in cells if c.text != 'N/A'], f'Table 5.2 ({program})')


def sum_text(printed: Sequence[float], where: str) -> str:
    """Whether the stages of a table of the thesis add up to its total, which comes last."""
    *stages, total = printed
    added = sum(stages)
    if abs(added - total) <= 0.001 * total:
        return f'The stages of {where} in the thesis add up to its total.'
    return (
        f'The stages of {where} in the thesis add up to {added:.4g} s, not to the {total:.5g} s '
        'that it prints as their total.'
    )

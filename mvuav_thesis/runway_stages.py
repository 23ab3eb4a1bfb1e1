"""Table 5.7: time per stage of the runway scheme over 150 frames."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from mvuav_ros.offline.report import Cell, Table
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.vision.point_operations import Mask, Pixels, select_channel
from mvuav_ros.vision.runway.correction import RhoThetaCorrection
from mvuav_ros.vision.runway.debug_images import draw_overlay
from mvuav_ros.vision.runway.detector import RunwayDetector, lines_on_frame
from mvuav_ros.vision.runway.edges import detect_edges, open_edges
from mvuav_ros.vision.runway.hough import HoughGrid
from mvuav_ros.vision.runway.peaks import Peak, find_peaks
from mvuav_ros.vision.runway.results import RunwayWorkings
from mvuav_thesis import known
from mvuav_thesis.comparison import METHOD, SHIPPED, Claim, Compared
from mvuav_thesis.plan import Plan, thesis_detector
from mvuav_thesis.stages import Stopwatch, read_avi, runway_images, sum_text, write_avi

INITIALISING, READING, PREPARING, HOUGH, CORRECTING, DRAWING, REST, TOTAL = known.RUNWAY_STAGES
_PROCESSING = 'processing'
_MEASURED = (READING, PREPARING, HOUGH, CORRECTING, DRAWING)
THESIS_YAML = 'config/thesis.yaml'


@dataclass(frozen=True)
class RunwayTimes:
    """Seconds of each row of the table, and how many frames there were."""

    seconds: Mapping[str, float]
    frames: int

    @property
    def rate_hz(self) -> float:
        """Frames per second without the initialisation, as the thesis counts."""
        return self.frames / (self.seconds[TOTAL] - self.seconds[INITIALISING])


def time_runway(plan: Plan) -> dict[str, RunwayTimes]:
    """The scheme with the thesis's parameters and with our defaults, over the same video."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / 'runway.avi'
        write_avi(path, runway_images(plan), known.RUNWAY_FPS)
        return {
            name: _time(path, parameters, plan.passes)
            for name, parameters in (
                (THESIS_YAML, thesis_detector()),
                (SHIPPED, RunwayDetectorParameters()),
            )
        }


def _time(path: Path, parameters: RunwayDetectorParameters, passes: int) -> RunwayTimes:
    watch = Stopwatch()
    frames: Sequence[Pixels] = ()
    for _ in range(passes):
        read, reading = read_avi(path, known.RUNWAY_FPS)
        frames = [frame.image.bgr() for frame in read]
        for number, seconds in enumerate(reading):
            watch.note(READING, number, seconds)
        _pass(frames, parameters, watch)
    sums = {stage: watch.total_s(stage) for stage in (INITIALISING, *_MEASURED)}
    total = sum(watch.total_s(s) for s in (INITIALISING, READING, _PROCESSING, DRAWING))
    return RunwayTimes({**sums, REST: total - sum(sums.values()), TOTAL: total}, len(frames))


def _pass(frames: Sequence[Pixels], parameters: RunwayDetectorParameters, watch: Stopwatch) -> None:
    """One pass of the scheme's stages over the frames, and of the scheme itself."""
    rows = slice(parameters.start_row, parameters.end_row)
    start = time.perf_counter()
    detector = RunwayDetector(parameters)
    height, width = frames[0][rows].shape[:2]
    grid = HoughGrid(height, width, parameters.rho_resolution, parameters.theta_resolution_deg)
    watch.note(INITIALISING, 0, time.perf_counter() - start)
    correction = RhoThetaCorrection(parameters)
    detector.process(frames[0], -1)
    detector.reset()
    for number, frame in enumerate(frames):
        edges = watch.time(PREPARING, number, _prepare, frame[rows], parameters)
        peaks = watch.time(HOUGH, number, _transform, grid, edges, parameters)
        workings = RunwayWorkings(frame, grid=grid, peaks=tuple(peaks))
        watch.time(CORRECTING, number, _correct, correction, workings, parameters.start_row)
        result = watch.time(_PROCESSING, number, detector.process, frame, number)
        watch.time(DRAWING, number, draw_overlay, result)


def _prepare(image: Pixels, parameters: RunwayDetectorParameters) -> Mask:
    gray = select_channel(image, parameters.channel)
    edges = detect_edges(gray, parameters.edge_threshold, thinning=parameters.edge_thinning)
    return open_edges(edges, parameters.opening_shape, parameters.opening_length)


def _transform(grid: HoughGrid, edges: Mask, parameters: RunwayDetectorParameters) -> list[Peak]:
    return find_peaks(
        grid.accumulate(edges),
        parameters.num_peaks,
        parameters.peak_threshold,
        parameters.peak_neighborhood_rho,
        parameters.peak_neighborhood_theta,
        grid.first_reachable_cell,
    )


def _correct(correction: RhoThetaCorrection, workings: RunwayWorkings, first_row: int) -> None:
    correction.correct(lines_on_frame(workings, first_row))


def table_5_7(times: Mapping[str, RunwayTimes], plan: Plan) -> Table:
    """The thesis's rows, with ours under its parameters and under our defaults."""
    ours, shipped = times[THESIS_YAML], times[SHIPPED]
    printed = {stage: known.cell('table_5_7', stage, 'time') for stage in known.RUNWAY_STAGES}
    share = {stage: 100.0 * cell.value / printed[TOTAL].value for stage, cell in printed.items()}
    rows = []
    for stage, cell in printed.items():
        beside: list[Cell] = [ours.seconds[stage], shipped.seconds[stage]]
        executions: Cell = 'N/A'
        if stage != REST:
            beside = [
                Compared(times[name].seconds[stage], cell.value, by)
                for name, by in ((THESIS_YAML, METHOD), (SHIPPED, SHIPPED))
            ]
            executions = 1 if stage in (INITIALISING, TOTAL) else ours.frames
        printed_executions = known.cell('table_5_7', stage, 'executions').text
        own_share = 100.0 * ours.seconds[stage] / ours.seconds[TOTAL]
        numbers = (printed_executions, executions, share[stage], own_share)
        rows.append((stage, cell.text, *beside, *numbers))
    said = [
        f'{stage} {part:g} % ({share[stage]:.1f})' for stage, part in known.RUNWAY_SHARES.items()
    ]
    return Table.of(
        'table_5_7',
        'Table 5.7: time per stage, runway',
        f'process | thesis [s] | here, {THESIS_YAML} [s] .5 | {SHIPPED} [s] .5 '
        '| executions, thesis | executions, here | share, thesis [%] .1 | share, here [%] .1',
        rows,
        f'{ours.frames} frames of 320x240 from an uncompressed AVI file; sums of the least of '
        f"{plan.passes} passes over each frame. The thesis's times are of Simulink on its "
        'machine. Image regeneration is the overlay; the rest is what the stages leave '
        'of the total: near zero it is noise, and it is not compared.',
        sum_text([cell.value for cell in printed.values()], 'Table 5.7'),
        f'Its text gives, with the quotient of its own numbers in brackets: {", ".join(said)}.',
    )


def runway_rate_claim(times: Mapping[str, RunwayTimes]) -> Claim:
    """The frame rate of the scheme."""
    rate = times[THESIS_YAML].rate_hz
    return Claim(
        'Frame rate of the runway scheme, reading included',
        f'{known.RUNWAY_HZ:g} Hz',
        f'{rate:.0f} Hz',
        rate >= known.RUNWAY_HZ,
    )

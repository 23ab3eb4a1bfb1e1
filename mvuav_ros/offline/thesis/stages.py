"""Tables 5.2 and 5.7: time per stage and its share.

The stages are timed by calling the pipelines' own functions one after the other on the same
frames; the whole is the pipeline's own call. What the stages leave of it is the rest.
"""

from __future__ import annotations

from collections.abc import Sequence

from mvuav_ros.offline.evaluation.stopwatch import Stopwatch
from mvuav_ros.offline.report.model import NOT_AVAILABLE, Cell, Column, Table
from mvuav_ros.offline.thesis import known
from mvuav_ros.offline.thesis.plan import Plan, detector, tracker
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.simulation.runway import RunwayFlight
from mvuav_ros.simulation.settings import RunwaySettings, TankerSettings
from mvuav_ros.simulation.tanker import TankerFlight
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.detection import area_fits
from mvuav_ros.vision.markers.grouping import bright_pixels, group_pixels
from mvuav_ros.vision.markers.labelling import label_five, roll_of
from mvuav_ros.vision.markers.motion import Motion
from mvuav_ros.vision.markers.results import (
    TANKER_LABELS,
    Cluster,
    Marker,
    MarkerState,
    Window,
)
from mvuav_ros.vision.markers.thesis_tracker import WHOLE_FRAMES, measure_window, window_around
from mvuav_ros.vision.markers.tracker import MarkerTracker
from mvuav_ros.vision.point_operations import Pixels, threshold
from mvuav_ros.vision.runway.detector import RunwayDetector
from mvuav_ros.vision.runway.edges import detect_edges, open_vertically, select_channel
from mvuav_ros.vision.runway.hough import HoughGrid
from mvuav_ros.vision.runway.peaks import find_peaks

WHOLE = 'whole'


def timed_images(plan: Plan) -> list[tuple[Image, int]]:
    """Frames of the trial with everything in it, and their stamps."""
    flight = TankerFlight(
        TankerSettings(motion='roll_translation', frames=plan.timed_frames, seed=plan.seed)
    )
    return [(frame.image, frame.stamp_ns) for frame in flight]


def table_5_2(frames: Sequence[tuple[Image, int]], passes: int) -> Table:
    """Stages of the marker programs: a whole frame, and a tracked one."""
    whole, tracked = Stopwatch(), Stopwatch()
    for _ in range(passes):
        time_detection(frames, whole)
        time_tracking(frames, tracked)
    rows = [
        *_rows('whole frame (Appendix A)', whole, f'{known.FULL_FRAME_MS:g} ms'),
        *_rows('tracked frame (Appendix C)', tracked, f'{known.TRACKED_MS:g} ms'),
    ]
    return _table(
        'table_5_2',
        'Table 5.2: time per stage, markers',
        rows,
        (
            f'{len(frames)} frames of 640x480, mono8; median over the frames of the least of '
            f'{passes} passes. Stages with the binary centroid and the velocity method, as in the '
            'thesis; a rest below zero is the noise of the measurement.',
            "The thesis's 85 and 30 ms are of MATLAB on its machine.",
        ),
    )


def time_detection(frames: Sequence[tuple[Image, int]], watch: Stopwatch) -> None:
    """One pass of Appendix A's stages over the frames."""
    parameters = tracker(mode='detect')
    pipeline = MarkerTracker(parameters)
    distance = parameters.grouping_distance
    for number, (image, stamp_ns) in enumerate(frames):
        gray = watch.time('grey', number, image.gray)
        mask = watch.time('threshold', number, threshold, gray, parameters.threshold)
        x, y = watch.time('collecting bright pixels', number, bright_pixels, mask)
        clusters = watch.time('grouping, centroids', number, group_pixels, x, y, distance)
        lights = [c for c in clusters if area_fits(c.area, parameters)]
        if len(lights) == len(TANKER_LABELS):
            order = watch.time('labelling', number, label_five, lights)
            markers = [
                Marker(label, MarkerState.DETECTED, lights[i].x, lights[i].y)
                for label, i in zip(TANKER_LABELS, order, strict=True)
            ]
            watch.time('roll', number, roll_of, markers)
        watch.time(WHOLE, number, pipeline.process, image, stamp_ns)


def time_tracking(frames: Sequence[tuple[Image, int]], watch: Stopwatch) -> None:
    """One pass of Appendix C's stages over the frames after the whole ones at the start."""
    parameters = tracker(mode='track', prediction='velocity')
    pipeline = MarkerTracker(parameters)
    motions = [Motion() for _ in TANKER_LABELS]
    for number, (image, stamp_ns) in enumerate(frames):
        time = (stamp_ns - frames[0][1]) * 1e-9
        if number < WHOLE_FRAMES:
            for motion, marker in zip(
                motions, pipeline.process(image, stamp_ns).markers, strict=True
            ):
                motion.add(time, marker.x, marker.y)
            continue
        places = watch.time('prediction', number, _predict, motions, time)
        windows = watch.time('windows', number, _windows, places, image, parameters)
        lights = watch.time('threshold, centroids', number, _measure, image, windows, parameters)
        watch.time('velocity, acceleration', number, _add, motions, time, lights)
        markers = [
            Marker(label, MarkerState.DETECTED, light.x, light.y)
            for label, light in zip(TANKER_LABELS, lights, strict=True)
        ]
        watch.time('roll', number, roll_of, markers)
        watch.time(WHOLE, number, pipeline.process, image, stamp_ns)


def _predict(motions: Sequence[Motion], time: float) -> list[tuple[float, float]]:
    return [motion.predict(time, 'velocity') for motion in motions]


def _windows(
    places: Sequence[tuple[float, float]], image: Image, parameters: MarkerTrackerParameters
) -> list[Window]:
    radius, width, height = parameters.search_radius, image.width, image.height
    return [window_around(x, y, radius, width, height) for x, y in places]


def _measure(
    image: Image, windows: Sequence[Window], parameters: MarkerTrackerParameters
) -> list[Cluster]:
    lights = [measure_window(image, window, parameters) for window in windows]
    # Of an undisturbed flight: every light is in its window.
    assert all(light is not None for light in lights)
    return [light for light in lights if light is not None]


def _add(motions: Sequence[Motion], time: float, lights: Sequence[Cluster]) -> None:
    for motion, light in zip(motions, lights, strict=True):
        motion.add(time, light.x, light.y)


def table_5_7(plan: Plan) -> Table:
    """Stages of the runway scheme."""
    settings = RunwaySettings(
        width=320,
        height=240,
        motion='low_pass',
        start_distance=-20.0,
        speed=25.0,
        camera_pitch_deg=20.0,
        frames=plan.timed_frames,
        seed=plan.seed,
    )
    images = [frame.image.bgr() for frame in RunwayFlight(settings)]
    watch = Stopwatch()
    for _ in range(plan.passes):
        time_runway(images, detector(), watch)
    return _table(
        'table_5_7',
        'Table 5.7: time per stage, runway',
        _rows('rows 50 to 130 of 320x240', watch, NOT_AVAILABLE),
        (
            f'{len(images)} frames of 320x240, bgr8; median over the frames of the least of '
            f"{plan.passes} passes. The rest is what the stages leave of the pipeline's own call: "
            'association, rho/theta correction, segments and statistics.',
        ),
    )


def time_runway(
    images: Sequence[Pixels], parameters: RunwayDetectorParameters, watch: Stopwatch
) -> None:
    """One pass of the runway scheme's stages over the frames."""
    pipeline = RunwayDetector(parameters)
    rows = slice(parameters.start_row, parameters.end_row)
    height, width = images[0][rows].shape[:2]
    grid = HoughGrid(height, width, parameters.rho_resolution, parameters.theta_resolution_deg)
    for number, image in enumerate(images):
        gray = watch.time('confining', number, select_channel, image[rows], parameters.channel)
        edges = watch.time('Sobel edges', number, detect_edges, gray, parameters.edge_threshold)
        opened = watch.time('opening', number, open_vertically, edges, parameters.opening_length)
        votes = watch.time('Hough transform', number, grid.accumulate, opened)
        watch.time(
            'peaks',
            number,
            find_peaks,
            votes,
            parameters.num_peaks,
            parameters.peak_threshold,
            parameters.peak_neighborhood_rho,
            parameters.peak_neighborhood_theta,
        )
        watch.time(WHOLE, number, pipeline.process, image, number)


def _rows(part: str, watch: Stopwatch, thesis: str) -> list[tuple[Cell, ...]]:
    total = watch.median_ms(WHOLE)
    stages = {name: watch.median_ms(name) for name in watch.stages if name != WHOLE}
    stages['rest'] = total - sum(stages.values())
    rows: list[tuple[Cell, ...]] = [
        (part, name, value, 100.0 * value / total, NOT_AVAILABLE) for name, value in stages.items()
    ]
    rows.append((part, 'together', total, 100.0, thesis))
    return rows


def _table(key: str, title: str, rows: list[tuple[Cell, ...]], notes: tuple[str, ...]) -> Table:
    columns = (
        Column('frame'),
        Column('stage'),
        Column('time', 'ms', 4),
        Column('share', '%', 1),
        Column('thesis'),
    )
    return Table(key, title, columns, tuple(rows), notes)

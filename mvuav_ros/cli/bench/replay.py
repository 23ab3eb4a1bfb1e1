"""How many times faster than real time recordings are replayed, on one core and on two."""

from __future__ import annotations

import importlib.util
import multiprocessing
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.cli.bench.case import Case

if TYPE_CHECKING:
    from mvuav_ros.offline.replay.job import ReplayJob

_RATE = 30
_TIMES_REAL_TIME = 15
_TWO_JOBS_GAIN = 1.7
_LEDS = ((-200, 0), (-72, -26), (0, -84), (72, -26), (200, 0))


def replay_cases(frames: int = _RATE * 15) -> list[Case]:
    """Both nodes over so many frames of 640x480 mono8; no cases where ROS is not installed.

    Every replay runs in a process that is there already, held on one core.
    """
    if importlib.util.find_spec('rclpy') is None:
        return []
    cores = sorted(os.sched_getaffinity(0))
    folder = TemporaryDirectory(prefix='mvuav_bench_')
    bags = [Path(folder.name) / f'{name}.mcap' for name in ('a', 'b')]
    for seed, bag in enumerate(bags):
        _write_bag(bag, frames, seed)
    pool = ProcessPoolExecutor(len(bags), multiprocessing.get_context('spawn'))

    def run(*chosen: Path) -> object:
        # The folder lives as long as the cases do.
        assert folder.name
        futures = [
            pool.submit(_replay, bag, cores[index % len(cores)]) for index, bag in enumerate(chosen)
        ]
        return [future.result() for future in futures]

    run(*bags)
    cases = [
        Case(
            f'replay {frames} frames 640x480, both nodes, one core',
            lambda: run(bags[0]),
            limit_ms=frames / _RATE / _TIMES_REAL_TIME * 1e3,
            note=pool.submit(_shares, bags[0], cores[0]).result(),
        )
    ]
    if len(cores) > 1:
        cases.append(
            Case(
                'replay two such bags in two processes',
                lambda: run(*bags),
                'one bag',
                lambda: run(bags[0]),
                limit_ratio=2 / _TWO_JOBS_GAIN,
                note=f'{_TWO_JOBS_GAIN} times the frames/s at the limit',
            )
        )
    return cases


def _replay(bag: Path, core: int) -> int:
    from mvuav_ros.offline.replay.job import ReplayOutcome, run_job

    job = _job(bag, core)
    outcome = ReplayOutcome(job.source, job.output)
    run_job(job, outcome, lambda _: None, ahead=False)
    assert outcome.answered == outcome.frames
    return outcome.answered


def _job(bag: Path, core: int) -> ReplayJob:
    """Hold this process on a core, as ``taskset`` does, and describe the job."""
    from mvuav_ros.offline.replay.job import ReplayJob, ReplaySettings
    from mvuav_ros.processing.process_tuning import keep_freed_memory
    from mvuav_ros.processing.registry import PROCESSORS

    os.sched_setaffinity(0, {core})
    cv2.setNumThreads(1)
    keep_freed_memory()
    parameters = {
        name: PROCESSORS[name].parameters_type().as_dict()
        for name in ('marker_tracker', 'runway_detector')
    }
    output = bag.with_suffix('.results.mcap')
    return ReplayJob(str(bag), output, ReplaySettings(parameters), overwrite=True)


def _shares(bag: Path, core: int) -> str:
    """Where the processor's time goes, in words."""
    from mvuav_ros.offline.replay.inputs import open_input
    from mvuav_ros.vision.markers.tracker import MarkerTracker
    from mvuav_ros.vision.runway.detector import RunwayDetector

    settings = _job(bag, core).settings
    start = time.thread_time()
    for _ in open_input(str(bag), None, None, settings.selection).items(False, False):
        pass
    reading = time.thread_time() - start
    spent = [0.0]
    with (
        patch.object(MarkerTracker, 'process', _timed(MarkerTracker.process, spent)),
        patch.object(RunwayDetector, 'process', _timed(RunwayDetector.process, spent)),
    ):
        start = time.process_time()
        _replay(bag, core)
        total = time.process_time() - start
    (vision,) = spent
    return (
        f'{(total - reading - vision) / total:.0%} outside reading and decoding '
        f'({reading / total:.0%}) and vision ({vision / total:.0%})'
    )


def _timed(method: Callable[..., Any], spent: list[float]) -> Callable[..., Any]:
    def call(*args: Any) -> Any:
        start = time.thread_time()
        try:
            return method(*args)
        finally:
            spent[0] += time.thread_time() - start

    return call


def _write_bag(path: Path, frames: int, seed: int) -> None:
    from mvuav_ros.recordings.images import IMAGE
    from mvuav_ros.recordings.serialization.cdr import cdr_header
    from mvuav_ros.recordings.serialization.serialized_image import serialize_image
    from mvuav_ros.recordings.writing import RecordingWriter
    from mvuav_ros.vision.image import Image

    random = np.random.default_rng(seed)
    with RecordingWriter(path) as writer:
        for index in range(frames):
            stamp_ns = 1_700_000_000_000_000_000 + round(index * 1e9 / _RATE)
            image = Image(_scene(index, random), 'mono8')
            message = serialize_image(image, cdr_header(stamp_ns, 'camera'))
            writer.write('/image_raw', IMAGE, stamp_ns, message)


def _scene(index: int, random: np.random.Generator) -> NDArray[np.uint8]:
    """Three lines that meet at the horizon, five lights that sway, and sensor noise."""
    frame = np.full((480, 640), 60, np.uint8)
    frame[:45] = 90
    apex = 320 + 3 * np.sin(index / 9), 30
    for left, right in ((-150, -140), (-5, 5), (140, 150)):
        corners = np.array([apex, (320 + left, 480), (320 + right, 480)])
        points = np.round(corners * 16).astype(np.int32)
        cv2.fillPoly(frame, [points], 140, cv2.LINE_AA, 4)
    for x, y in _LEDS:
        center = round((320 + x + 20 * np.sin(index / 20)) * 16), (300 + y) * 16
        cv2.circle(frame, center, 48, 240, -1, cv2.LINE_AA, 4)
    # Nothing is brighter than 240: the sum stays within 8 bits.
    return frame + random.integers(0, 9, frame.shape, dtype=np.uint8)

"""How fast one recording is replayed, by one thread and by two, beside what anybody needs."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import cv2
import numpy as np

from mvuav_ros.cli.bench.case import Case
from mvuav_ros.cli.bench.scenes import lights_above_runway

_RATE = 30
_TIMES_REAL_TIME = 15
_TWO_JOBS_GAIN = 1.6
_FLOOR_LIMIT = 1.6
_THRESHOLD = 128
_NODES = ('marker_tracker', 'runway_detector')


class _Replay(NamedTuple):
    """A replay of a bag with nodes by a thread for each of some cores; no nodes: the floor."""

    bag: Path
    nodes: tuple[str, ...]
    cores: list[int]


def replay_cases(frames: int = _RATE * 15) -> list[Case]:
    """Bags of raw 640x480 and of JPEG 1920x1080; no cases where ROS is not installed.

    Every replay runs in a process that is there already.
    """
    if importlib.util.find_spec('rclpy') is None:
        return []
    from mvuav_ros.offline.tasks import Done, Worker

    folder = TemporaryDirectory(prefix='mvuav_bench_')
    worker = Worker(_do)

    def action(replay: _Replay) -> Callable[[], object]:
        def run() -> object:
            # The folder lives as long as the cases do.
            assert folder.name
            worker.send(0, replay)
            done = worker.receive()
            assert isinstance(done, Done)
            if done.error is not None:
                raise done.error
            return done.result

        return run

    raw, jpeg = Path(folder.name) / 'raw.mcap', Path(folder.name) / 'jpeg.mcap'
    fewer = max(1, frames // 5)
    _write_bag(raw, frames, None)
    _write_bag(jpeg, fewer, (1920, 1080))
    return [
        *_cases_of(f'{frames} frames 640x480', raw, frames, action),
        *_cases_of(f'{fewer} frames JPEG 1920x1080', jpeg, fewer, action),
    ]


def _cases_of(
    name: str, bag: Path, frames: int, action: Callable[[_Replay], Callable[[], object]]
) -> list[Case]:
    cores = sorted(os.sched_getaffinity(0))
    one = action(_Replay(bag, _NODES, cores[:1]))
    floor = action(_Replay(bag, (), cores[:1]))
    raw = '640x480' in name
    limit_ms = frames / _RATE / _TIMES_REAL_TIME * 1e3 if raw else None
    cases = [Case(f'replay {name}, both nodes, one core', one, limit_ms=limit_ms)]
    for node in _NODES:
        alone = action(_Replay(bag, (node,), cores[:1]))
        beside = ('read, decode, threshold', floor, _FLOOR_LIMIT)
        cases.append(Case(f'replay {name}, {node}', alone, *beside))
    if len(cores) > 1:
        both = action(_Replay(bag, _NODES, cores[:2]))
        limit, note = 1 / _TWO_JOBS_GAIN, f'{_TWO_JOBS_GAIN} times the frames/s at the limit'
        title = f'replay {name}, both nodes, --jobs 2'
        cases.append(Case(title, both, '--jobs 1', one, limit, note=note))
    return cases


def _do(replay: _Replay, _report: object, stop: Any) -> int:
    from mvuav_ros.offline.replay.job import ReplayJob, ReplaySettings, attempt

    os.sched_setaffinity(0, replay.cores)
    if not replay.nodes:
        return _floor(replay.bag)
    settings = ReplaySettings({node: {} for node in replay.nodes})
    output = str(replay.bag.with_suffix('.results.mcap'))
    job = ReplayJob(str(replay.bag), output, settings, True)
    outcome = attempt(job, lambda _: None, stop, len(replay.cores))
    assert outcome.processed == outcome.frames, outcome
    return outcome.processed


def _floor(bag: Path) -> int:
    """What any implementation needs: every frame read, decoded and compared with a threshold."""
    from mvuav_ros.sources.bag import BagImages

    count = 0
    source = BagImages(bag)
    for frame in source.frames():
        cv2.threshold(frame.image.gray(), _THRESHOLD, 255, cv2.THRESH_BINARY)  # type: ignore[union-attr]
        count += 1
    source.close()
    return count


def _write_bag(path: Path, frames: int, jpeg_size: tuple[int, int] | None) -> None:
    from mvuav_ros.messages.cdr import cdr_header
    from mvuav_ros.messages.images import COMPRESSED_IMAGE, IMAGE, serialize_image, serialize_jpeg
    from mvuav_ros.recordings.writing import RecordingWriter
    from mvuav_ros.vision.image import Image

    random = np.random.default_rng(0)
    with RecordingWriter(path) as writer:
        for index in range(frames):
            stamp_ns = 1_700_000_000_000_000_000 + round(index * 1e9 / _RATE)
            header = cdr_header(stamp_ns, 'camera')
            noise = random.integers(0, 9, (480, 640), dtype=np.uint8)
            scene = np.asarray(cv2.add(lights_above_runway(640, 480, index), noise), np.uint8)
            if jpeg_size is None:
                message = serialize_image(Image(scene, 'mono8'), header)
                writer.write('/image_raw', IMAGE, stamp_ns, message)
                continue
            colour = cv2.cvtColor(cv2.resize(scene, jpeg_size), cv2.COLOR_GRAY2BGR)
            message = serialize_jpeg(Image(np.asarray(colour, np.uint8), 'bgr8'), header)
            writer.write('/image_raw/compressed', COMPRESSED_IMAGE, stamp_ns, message)

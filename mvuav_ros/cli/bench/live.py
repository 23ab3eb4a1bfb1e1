"""``mvuav bench live``: nodes as processes on real DDS, beside a subscriber that only takes."""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path

import numpy as np

from mvuav_ros.cli.node_processes import NodeProcess, NodeProcesses
from mvuav_ros.sources.source import SourceError

_PROCESSES = 'mvuav_ros.cli.bench.live_processes'
FLOOR = 'bench_floor'
"""The node that takes images and answers without looking at them."""
SIZES = ((640, 480), (1280, 720), (1920, 1080))
MAX_OVER_ANSWER = 1.6
"""Median latency at 640x480 may be so many times that of a node which answers at once."""


@dataclass(frozen=True)
class LiveCase:
    """One stream of images and the nodes that answer it."""

    nodes: tuple[str, ...]
    width: int = 640
    height: int = 480
    encoding: str = 'mono8'
    transport: str = 'raw'
    hz: float = 60


@dataclass(frozen=True)
class LiveResult:
    """What became of a stream of images sent, for one of its nodes.

    ``latency``: p50, p95 and p99 (ms) from an image's stamp to its result's arrival back at the
    camera, of those processed; ``answer``: the same of a node that answers without looking at the
    image, and ``floor``: from the stamp to that node's callback. The processor time is of all
    threads, per image; the memory is resident, at the end. ``status`` are the node's newest
    diagnostics.
    """

    case: LiveCase
    node: str
    sent: int
    processed: int
    latency: tuple[float, float, float]
    floor_taken: int
    floor: tuple[float, float, float]
    answer: tuple[float, float, float]
    cpu_ms: float
    memory_mb: float
    status: dict[str, str]

    @property
    def ratio(self) -> float:
        """Median latency as a multiple of the floor's."""
        return self.latency[0] / self.floor[0]

    @property
    def limit(self) -> float | None:
        """What the median latency may be, ms; None where nothing is promised."""
        case = self.case
        promised = case.width == 640 and case.transport == 'raw' and len(case.nodes) == 1
        return MAX_OVER_ANSWER * self.answer[0] if promised else None

    @property
    def within_limits(self) -> bool:
        """Whether the promise is kept."""
        return self.limit is None or self.latency[0] <= self.limit

    def figures(self) -> dict[str, object]:
        """For a JSON file."""
        more = {'ratio': self.ratio, 'limit_ms': self.limit}
        return {**asdict(self), **more, 'within_limits': self.within_limits}


def live_cases(full: bool) -> list[LiveCase]:
    """A short matrix, or every combination."""
    marker, runway = ('marker_tracker',), ('runway_detector',)
    if full:
        encodings, transports, rates = ('mono8', 'bgr8'), ('raw', 'compressed'), (30, 60, 120)
        every = product(SIZES, encodings, transports, rates, (marker, runway))
        return [LiveCase(nodes, *size, code, way, hz) for size, code, way, hz, nodes in every]
    both = marker + runway
    return [
        *(LiveCase(marker, hz=hz) for hz in (30, 60, 120)),
        LiveCase(runway),
        LiveCase(runway, encoding='bgr8'),
        LiveCase(both, hz=120),
        LiveCase(marker, encoding='bgr8'),
        LiveCase(marker, transport='compressed'),
        LiveCase(marker, 1280, 720),
        LiveCase(both, 1920, 1080),
        LiveCase(marker, 1920, 1080, 'bgr8', hz=30),
    ]


def measure_live(case: LiveCase, seconds: float) -> list[LiveResult]:
    """Run one stream; a result for each of its nodes.

    Raises:
        SourceError: a process failed.
    """
    settings = ('--ros-args', '-p', f'image_transport:={case.transport}')
    with NodeProcesses() as processes:
        floor = processes.start(_PROCESSES, 'floor', case.transport)
        nodes = {name: processes.start('mvuav_ros', name, *settings) for name in case.nodes}
        orders = {**asdict(case), 'seconds': seconds, 'subscribers': len(case.nodes) + 1}
        camera = processes.start(_PROCESSES, 'camera', json.dumps(orders))
        camera.wait_for('begin')
        before = {name: _usage(process) for name, process in nodes.items()}
        camera.wait_for('end')
        after = {name: _usage(process) for name, process in nodes.items()}
        answer = json.loads(camera.wait_for('{'))
        floor.interrupt()
        floor_taken = json.loads(floor.wait_for('{'))
    sent = answer['sent']
    floor_ms = _latencies(sent, floor_taken)
    latencies = {name: _latencies(sent, came) for name, came in answer['results'].items()}
    return [
        LiveResult(
            case=case,
            node=name,
            sent=len(sent),
            processed=len(latencies[name]),
            latency=_percentiles(latencies[name]),
            floor_taken=len(floor_ms),
            floor=_percentiles(floor_ms),
            answer=_percentiles(latencies[FLOOR]),
            cpu_ms=(after[name][0] - before[name][0]) * 1e3 / len(sent),
            memory_mb=after[name][1],
            status=answer['status'].get(name, {}),
        )
        for name in case.nodes
    ]


def _latencies(sent: list[int], arrivals: dict[str, int]) -> list[float]:
    """Of the images that count, ms; arrivals are keyed by stamp."""
    return [(arrivals[str(ns)] - ns) * 1e-6 for ns in sent if str(ns) in arrivals]


def _percentiles(latencies: list[float]) -> tuple[float, float, float]:
    p50, p95, p99 = np.percentile(latencies or [math.nan], (50, 95, 99)).tolist()
    return p50, p95, p99


def _usage(process: NodeProcess) -> tuple[float, float]:
    """Processor seconds and resident MB."""
    if failure := process.failure():
        raise SourceError(failure)
    folder = Path(f'/proc/{process.pid}')
    # After the command's name in brackets, which may hold blanks.
    fields = (folder / 'stat').read_text().rsplit(')', 1)[1].split()
    pages = int((folder / 'statm').read_text().split()[1])
    ticks = int(fields[11]) + int(fields[12])
    return ticks / os.sysconf('SC_CLK_TCK'), pages * os.sysconf('SC_PAGE_SIZE') / 1e6

"""Play the sample bags through real nodes and record what they publish."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text
from sensor_msgs.msg import Image

from mvuav_ros.cli.demo.figures import save_roll, save_runway, save_tanker
from mvuav_ros.cli.demo.sample_flights import SampleFlight, sample_flights
from mvuav_ros.cli.node_processes import NodeProcesses
from mvuav_ros.messages.sensors import type_name
from mvuav_ros.nodes.running import prepare_transport
from mvuav_ros.offline.evaluation.evaluation_run import read_bag
from mvuav_ros.panel.live_results import TOPICS, Figures
from mvuav_ros.recordings.writing import RecordingWriter
from mvuav_ros.sources.source import SourceError

EVERYTHING = QoSProfile(history=HistoryPolicy.KEEP_ALL, depth=1)
MAX_DURATION = 50.0
"""s to start, and s to play; the demo ends by itself whatever happens."""
SETTLING_TIME = 0.5
"""Seconds from the moment that a node is seen until its messages surely arrive."""
SILENCE = 0.5
"""Seconds without a message after which nothing follows the last frame's results."""


class DemoRecorder(Node):
    """Writes every message as it came over DDS.

    Keeps the ``newest`` of each topic but images', their ``counts``, and each node's diagnostics of
    when it had frames: ``status``.
    """

    def __init__(self, topics: dict[str, type], writer: RecordingWriter, context: Any) -> None:
        super().__init__('demo_recorder', context=context)
        self.newest: dict[str, Any] = {}
        self.counts = dict.fromkeys(topics, 0)
        self.status: dict[str, dict[str, str]] = {}
        self.changed_at = time.monotonic()
        self._writer = writer
        for topic, kind in topics.items():
            keep = partial(self._keep, topic, kind)
            self.create_subscription(kind, topic, keep, EVERYTHING, raw=True)
        self.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)

    def _keep(self, topic: str, kind: type, data: bytes) -> None:
        self._writer.write(topic, type_name(kind), time.time_ns(), data)
        self.counts[topic] += 1
        self.changed_at = time.monotonic()
        if kind is not Image:
            self.newest[topic] = deserialize_message(data, kind)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if values.get('latency_p50_ms', 'nan') != 'nan':
                self.status[status.name.strip('/')] = values


def run_demo(bags: Path, out: Path, console: Console) -> list[Path]:
    """Show the demo and leave a bag and three figures in ``out``; returns the files.

    Raises:
        SourceError: a bag is missing, or a node failed.
    """
    flights = sample_flights(bags, with_thesis=True)
    out.mkdir(parents=True, exist_ok=True)
    bag = out / 'demo.mcap'
    prepare_transport()
    context = rclpy.Context()
    with RecordingWriter(bag, overwrite=True) as writer, NodeProcesses() as nodes:
        rclpy.init(context=context, domain_id=nodes.domain_id)
        try:
            recorder = DemoRecorder(_topics(flights), writer, context)
            for flight in flights:
                flight.start_node(nodes)
            _watch(flights, recorder, nodes, console)
            recorder.destroy_node()
        finally:
            rclpy.try_shutdown(context=context)
    flown, made = {flight.name: flight.bag for flight in flights}, [bag]
    if 'tanker' in flown:
        run = read_bag(bag)
        made += [save_tanker(run, bag, out / 'tanker.png')]
        made += [save_roll(run, flown['tanker'], out / 'roll.png')]
    if 'runway' in flown:
        made += [save_runway(bag, flown['runway'], out / 'runway.png')]
    return made


def _topics(flights: list[SampleFlight]) -> dict[str, type]:
    topics: dict[str, type] = {}
    for flight in flights:
        topics[flight.image_topic] = Image
        topics.update({flight.topic(name): kind for name, kind in flight.processor.topics.items()})
        topics.update({flight.topic(name): Image for name in flight.processor.debug_topics})
    return topics


def _watch(
    flights: list[SampleFlight], recorder: DemoRecorder, nodes: NodeProcesses, console: Console
) -> None:
    """Play the bags once the recorder finds every node, until every frame is answered."""
    executor = SingleThreadedExecutor(context=recorder.context)
    executor.add_node(recorder)
    end = time.monotonic() + MAX_DURATION
    playing = False
    shown, ready_at = 0.0, None
    with Live(console=console, auto_refresh=False) as live:
        while (now := time.monotonic()) < end:
            executor.spin_once(timeout_sec=0.05)
            if now - shown > 0.1:
                live.update(_screen(flights, recorder), refresh=True)
                shown = now
            if ready_at is None and all(recorder.count_publishers(f.main) for f in flights):
                ready_at = now
            if ready_at is not None and not playing and now - ready_at > SETTLING_TIME:
                playing = True
                end = now + MAX_DURATION
                # Each bag once, however many nodes look at it beside the recorder.
                for bag, flight in {flight.bag: flight for flight in flights}.items():
                    listeners = 1 + sum(other.bag == bag for other in flights)
                    flight.start_source(nodes, wait_for_subscribers=str(listeners))
            if reason := nodes.failure():
                raise SourceError(reason)
            answered = all(recorder.counts[flight.main] >= flight.frames for flight in flights)
            if answered and now - recorder.changed_at > SILENCE:
                break
    executor.shutdown()
    for flight in flights:
        if not recorder.counts[flight.main]:
            raise SourceError(f'{flight.node_name} published nothing within {MAX_DURATION:.0f} s')


def _screen(flights: list[SampleFlight], recorder: DemoRecorder) -> Group:
    parts: list[Any] = []
    for flight in flights:
        said, status = _said(flight, recorder), recorder.status.get(flight.node_name, {})
        words = (
            f'{flight.node_name} ({flight.title})   frame {recorder.counts[flight.main]} of '
            f'{recorder.counts[flight.image_topic]}   {status.get("output_rate_hz", "-")} Hz   '
            f'latency {status.get("latency_p50_ms", "-")} ms'
        )
        table = Table(box=None, pad_edge=False, show_header=False)
        for figure in said['figures']:
            table.add_row(*figure)
        parts += [Text(words, style='bold'), Text(said['trust'][1]), table, Text()]
    return Group(*parts)


def _said(flight: SampleFlight, recorder: DemoRecorder) -> dict[str, Any]:
    """A node's newest results, as the panel says them."""
    values = flight.processor.parameters_type.from_mapping(flight.parameters).as_dict()
    figures = Figures(flight.processor.name, lambda: values)
    for topic in TOPICS[flight.processor.name]:
        if flight.topic(topic) in recorder.newest:
            figures.take(topic, recorder.newest[flight.topic(topic)])
    return figures.said()

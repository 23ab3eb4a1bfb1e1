"""Play the sample bags through real nodes, record what they publish, and draw three figures."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text
from sensor_msgs.msg import Image

from mvuav_ros.cli.demo.sample_flights import SampleFlight, sample_flights
from mvuav_ros.cli.node_processes import NodeProcesses
from mvuav_ros.messages.definitions import decode_message
from mvuav_ros.messages.images import decode_image
from mvuav_ros.messages.sensors import stamp_ns_of, type_name
from mvuav_ros.nodes.running import prepare_transport
from mvuav_ros.offline.evaluation.bag_report import roll_figure
from mvuav_ros.offline.evaluation.evaluation_run import EvaluationRun, read_bag
from mvuav_ros.offline.evaluation.metrics import roll_errors
from mvuav_ros.panel.live_results import TOPICS, Figures
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.remote import write_whole
from mvuav_ros.recordings.writing import RecordingWriter
from mvuav_ros.sources.source import SourceError
from mvuav_ros.vision.markers.marker_results import TANKER_NAMES, MarkerState

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
        errors = roll_errors(replace(run, truth=read_bag(flown['tanker']).truth))
        if errors is None:
            raise SourceError(f'no roll was measured in a frame of {flown["tanker"]}')
        made += [out / 'roll.png']
        write_whole(made[-1], roll_figure(errors).png)
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


_GREEN, _YELLOW = '#50e66e', '#ffd800'
_SHADOW = [withStroke(linewidth=3, foreground='black')]


def _read(bag: Path, topic: str) -> dict[int, Any]:
    """One topic's messages by their stamps (ns)."""
    with open_recording(bag) as recording:
        messages = [decode_message(each.type, each.data) for each in recording.messages({topic})]
    return {stamp_ns_of(message.header): message for message in messages}


def save_tanker(run: EvaluationRun, bag: Path, target: Path) -> Path:
    """Two frames with the names of the lights: all in view, and one of them off."""
    markers, rolls = run.results.markers, run.results.rpy
    images = _read(bag, '/tanker/image_raw')
    poses = _read(bag, '/marker_tracker/pose')
    stamps = sorted(images.keys() & markers.keys() & rolls.keys() & poses.keys())
    off = [stamp for stamp in stamps if (markers[stamp]['state'] == MarkerState.PREDICTED).any()]
    shown = [stamps[len(stamps) // 3], *off[len(off) // 2 :][:1]]
    figure, axes = _side_by_side(len(shown))
    titles = ('All five lights found and named', 'One light is off: its place is predicted')
    for axis, stamp, title in zip(axes.flat, shown, titles, strict=False):
        _show(axis, images[stamp])
        _draw_names(axis, markers[stamp])
        distance = poses[stamp].pose.pose.position.z
        roll = np.degrees(rolls[stamp])
        down = 'right' if roll > 0 else 'left'
        axis.set_title(f'{title}\nroll {roll:+.1f}° ({down} wing down), {distance:.0f} m away')
    figure.savefig(target, dpi=100)
    return target


def _draw_names(axis: Axes, rows: NDArray[Any]) -> None:
    middle = np.array([rows['x'].mean(), rows['y'].mean()])
    for row in rows:
        predicted = row['state'] == MarkerState.PREDICTED
        color, word = (_YELLOW, ' (predicted)') if predicted else (_GREEN, '')
        place = np.array([row['x'], row['y']])
        away = (place - middle) / max(1.0, float(np.hypot(*(place - middle))))
        axis.plot(*place, 'o', ms=14, mfc='none', mec=color, mew=2)
        name = TANKER_NAMES[row['label']].replace('_', ' ') + word
        x, y = place + away * 38
        style: Any = {'ha': 'center', 'va': 'center', 'path_effects': _SHADOW}
        axis.text(x, y, name, color=color, clip_on=True, **style)


def save_runway(bag: Path, sample: Path, target: Path) -> Path:
    """One frame as two nodes draw it: mode approach with its guidance, and the thesis's scheme."""
    approach = _read(bag, '/runway_detector/debug/overlay')
    poses = _read(bag, '/runway_detector/pose')
    thesis = _read(bag, '/runway_thesis/debug/overlay')
    truth = _read(sample, '/truth/pose')
    stamps = sorted(approach.keys() & poses.keys() & thesis.keys() & truth.keys())
    stamp = stamps[len(stamps) // 3]
    here, there = poses[stamp].pose.pose.position, truth[stamp].pose.position
    side = 'left' if here.y > 0 else 'right'
    figure, axes = _side_by_side(2)
    left, right = axes.flat
    _show(left, approach[stamp])
    left.set_title(
        'Mode approach finds the runway by itself\n'
        f'{abs(here.y):.1f} m {side} of the centreline, {here.z:.1f} m high '
        f'(truth: {abs(there.y):.1f} m, {there.z:.1f} m)'
    )
    _show(right, thesis[stamp])
    right.set_title(
        "The thesis's scheme draws the strongest lines\n"
        'green agrees with the last frame; red has jumped, and kept its old place'
    )
    figure.savefig(target, dpi=100)
    return target


def _side_by_side(count: int) -> tuple[Figure, Any]:
    figure = Figure(figsize=(6.5 * count, 5.6), layout='constrained')
    return figure, figure.subplots(1, count, squeeze=False)


def _show(axis: Axes, message: Any) -> None:
    image = decode_image(message).bgr()
    axis.imshow(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), interpolation='bilinear')
    axis.set(xticks=[], yticks=[], xlim=(0, image.shape[1]), ylim=(image.shape[0], 0))

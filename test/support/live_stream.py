"""Frames at a pace into live nodes, and their answers."""

from __future__ import annotations

import math
import os
import time
from pathlib import Path
from typing import Any

from rclpy.qos import QoSProfile
from sensor_msgs.msg import CompressedImage, PointCloud2
from sensor_msgs.msg import Image as RosImage

from mvuav_ros.messages.cdr import cdr_header, view_points
from mvuav_ros.messages.images import serialize_image
from mvuav_ros.vision.image import Image
from support.graph import EVERYTHING, Graph
from support.marker_scenes import draw, tanker_at

RESULTS = {'marker_tracker': 'markers', 'runway_detector': 'line_params'}
START_NS = 1_700_000_000_000_000_000
# Every single message is to reach the node and every answer us, however fast they come and however
# long one of us has to wait for the processor.
KEEP_EVERYTHING = {
    **{
        f'qos_overrides.{topic}.subscription.{policy}': value
        for topic in ('/image_raw', '/image_raw/compressed')
        for policy, value in (('reliability', 'reliable'), ('history', 'keep_all'))
    },
    **{
        f'qos_overrides./{node}/{topic}.publisher.history': 'keep_all'
        for node, topic in RESULTS.items()
    },
}


def _topics_of(node: str, parameters: dict[str, Any], compressed: bool) -> dict[str, Any]:
    """Without the overrides of topics that the node does not have, which it warns of."""
    image = 'image_raw/compressed' if compressed else 'image_raw'
    own = tuple(f'qos_overrides./{topic}.' for topic in (image, f'{node}/{RESULTS[node]}'))
    return {
        name: value
        for name, value in parameters.items()
        if name.startswith(own) or not name.startswith('qos_overrides.')
    }


def memory_mb(pid: int) -> float:
    """What is resident of a process."""
    pages = int(Path(f'/proc/{pid}/statm').read_text().split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') / 1e6


class Stream:
    """A camera in the test's process in front of one or more nodes."""

    def __init__(self, graph: Graph, *nodes: str, compressed: bool = False, **parameters: Any):
        self.graph, self.index = graph, 0
        self.processes = {
            name: graph.start(name, **_topics_of(name, parameters, compressed)) for name in nodes
        }
        self.answers = {
            name: graph.listen(f'/{name}/{RESULTS[name]}', PointCloud2) for name in nodes
        }
        kind, topic = (
            (CompressedImage, '/image_raw/compressed') if compressed else (RosImage, '/image_raw')
        )
        qos = EVERYTHING if 'keep_all' in parameters.values() else QoSProfile(depth=10)
        self.publisher = graph.probe.create_publisher(kind, topic, qos)
        graph.until(lambda: self.publisher.get_subscription_count() == len(nodes), 'the nodes')
        graph.spin(0.3)

    def next_stamp(self, hz: float = 60.0) -> int:
        self.index += 1
        return START_NS + round(self.index * 1e9 / hz)

    def good(self, hz: float = 60.0) -> bytes:
        """The next frame of a tanker's flight, serialized."""
        pixels = draw(tanker_at(320 + 25 * math.sin(self.index / 15), 240))
        return serialize_image(Image(pixels, 'mono8'), cdr_header(self.next_stamp(hz), 'nose'))

    def play(self, seconds: float, hz: float = 60.0, beside: Any = None) -> int:
        """Publish good frames at a pace; ``beside`` is called after each. Returns their number."""
        count, due = round(seconds * hz), time.monotonic()
        for _ in range(count):
            self.publisher.publish(self.good(hz))
            if beside is not None:
                beside()
            due += 1.0 / hz
            self.graph.spin(max(due - time.monotonic(), 0.0005))
        return count

    def counts(self) -> dict[str, int]:
        return {name: len(answers) for name, answers in self.answers.items()}

    def until_answered(self, count: int, timeout: float = 120.0) -> None:
        """Wait until every node has answered that many frames in all."""
        self.graph.until(
            lambda: all(len(answers) >= count for answers in self.answers.values()),
            lambda: f'{count} answers, got {self.counts()}',
            timeout,
        )

    def states(self, name: str = 'marker_tracker') -> list[int]:
        """The states in the newest markers."""
        return list(view_points(self.answers[name][-1])['state'])

    def check_alive(self) -> None:
        for name, process in self.processes.items():
            assert process.poll() is None, f'{name} died: {process.communicate()[0]}'

"""``vision_process``: a source and its detectors in one process, without DDS between them."""

from __future__ import annotations

import sys

from mvuav_ros.nodes.managed_node import ManagedNode
from mvuav_ros.nodes.running import run_nodes
from mvuav_ros.nodes.video_source import VideoSource
from mvuav_ros.nodes.vision_node import VisionNode
from mvuav_ros.processing.registry import PROCESSORS


def make_nodes() -> list[ManagedNode]:
    """Both detectors and the source, whose frames they take as they are.

    The nodes have the names, parameters and topics that they have in processes of their own.
    """
    detectors = [VisionNode(processor(), handed_over=True) for processor in PROCESSORS.values()]
    source = VideoSource(
        [detector.take for detector in detectors],
        lambda: sum(detector.listens for detector in detectors),
    )
    # The source last: what it plays is to be answered from the first frame on.
    return [*detectors, source]


def main() -> None:
    """Run the nodes."""
    sys.exit(run_nodes(make_nodes, camera_images=True))

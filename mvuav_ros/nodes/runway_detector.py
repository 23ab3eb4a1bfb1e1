"""``runway_detector``: a runway's lines, checked against the last frame."""

from __future__ import annotations

import sys

from mvuav_ros.nodes.running import run_nodes
from mvuav_ros.nodes.vision_node import VisionNode
from mvuav_ros.processing.runway_detector import RunwayDetectorProcessor


def main() -> None:
    """Run the node."""
    sys.exit(run_nodes(lambda: [VisionNode(RunwayDetectorProcessor())]))

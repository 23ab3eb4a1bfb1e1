"""``marker_tracker``: the tanker's marker lights, their labels and the roll."""

from __future__ import annotations

import sys

from mvuav_ros.nodes.running import run_nodes
from mvuav_ros.nodes.vision_node import VisionNode
from mvuav_ros.processing.marker_tracker import MarkerTrackerProcessor


def main() -> None:
    """Run the node."""
    sys.exit(run_nodes(lambda: [VisionNode(MarkerTrackerProcessor())]))

"""The executables: which nodes run in a process. Each imports no more than it runs."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Sequence
from functools import partial

from mvuav_ros.nodes.managed_node import ManagedNode
from mvuav_ros.nodes.running import run_nodes
from mvuav_ros.processing.processor import Processor

MARKERS, RUNWAY, SOURCE = NODES = ('marker_tracker', 'runway_detector', 'video_source')


def nodes_of(names: Sequence[str]) -> Callable[[], list[ManagedNode]]:
    """What makes the nodes of one process, with the names, parameters and topics of all others.

    Beside a source detectors take its frames as they are, without DDS in between.
    """
    from mvuav_ros.nodes.vision_node import VisionNode

    handed_over = SOURCE in names
    processors: list[type[Processor]] = []
    if MARKERS in names:
        from mvuav_ros.processing.marker_processor import MarkerTrackerProcessor

        processors.append(MarkerTrackerProcessor)
    if RUNWAY in names:
        from mvuav_ros.processing.runway_processor import RunwayDetectorProcessor

        processors.append(RunwayDetectorProcessor)
    if handed_over:
        from mvuav_ros.nodes.video_source import VideoSource

    def make() -> list[ManagedNode]:
        detectors = [VisionNode(each(), handed_over=handed_over) for each in processors]
        if not handed_over:
            return list(detectors)
        takers = [detector.take for detector in detectors]
        source = VideoSource(takers, lambda: sum(detector.listens for detector in detectors))
        # The source last: what it plays is to be answered from the first frame on.
        return [*detectors, source]

    return make


def _run(name: str) -> None:
    _parse(ArgumentParser(name))
    sys.exit(run_nodes(nodes_of([name]), camera_images=name == SOURCE))


def vision_process() -> None:
    """Run several nodes in one process."""
    parser = ArgumentParser('vision_process', description='Several nodes in one process.')
    words = f'separated by commas, of {", ".join(NODES)}; all unless given'
    parser.add_argument('--nodes', default=','.join(NODES), help=words)
    names = [name.strip() for name in _parse(parser).nodes.split(',')]
    if unknown := [name for name in names if name not in NODES]:
        parser.error(f'--nodes: {unknown[0]!r} is not one of {", ".join(NODES)}')
    sys.exit(run_nodes(nodes_of(names), camera_images=SOURCE in names))


def own_arguments() -> list[str]:
    """The command line without what is ROS's: from ``--ros-args`` to ``--`` or the end.

    rclpy's own function stumbles over a mistake in those.
    """
    words, own, is_ros = sys.argv[1:], [], False
    for word in words:
        is_ros = (is_ros or word == '--ros-args') and word != '--'
        if not is_ros and word != '--':
            own.append(word)
    return own


def _parse(parser: ArgumentParser) -> Namespace:
    """A process's own arguments; those of ROS without --ros-args would do nothing: refused."""
    parser.epilog = 'Arguments of ROS follow --ros-args: -p NAME:=VALUE, --params-file FILE …'
    own, strange = parser.parse_known_args(own_arguments())
    if strange:
        parser.error(f'{" ".join(strange)}: not used; arguments of ROS follow --ros-args')
    return own


marker_tracker, runway_detector, video_source = (partial(_run, name) for name in NODES)

"""What the demo shows: for each node its sample bag, topics and parameters."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from mvuav_ros.cli.node_processes import NodeProcesses
from mvuav_ros.messages.images import IMAGE
from mvuav_ros.parameters.declaration import Value
from mvuav_ros.processing.marker_processor import MarkerTrackerProcessor
from mvuav_ros.processing.processor import Processor
from mvuav_ros.processing.runway_processor import RunwayDetectorProcessor
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.sources.source import SourceError

_INPUTS = ('image_raw', 'camera_info')


@dataclass(frozen=True)
class SampleFlight:
    """A sample bag, whose name is the namespace of its images, and the node that looks at it."""

    bag: Path
    processor: type[Processor]
    node_name: str
    parameters: dict[str, Value] = field(default_factory=dict)
    title: str = ''  # shown behind the node's name

    @cached_property
    def frames(self) -> int:
        """Images in the bag."""
        with open_recording(self.bag) as recording:
            return sum(message.type == IMAGE for message in recording.messages())

    @property
    def name(self) -> str:
        """The bag's, without suffix."""
        return self.bag.stem

    @property
    def image_topic(self) -> str:
        """Where the bag's images are published."""
        return f'/{self.name}/image_raw'

    @property
    def main(self) -> str:
        """The full name of the topic that has one message per frame."""
        return self.topic(self.processor.panel.known_by)

    def topic(self, suffix: str) -> str:
        """A result topic's full name."""
        return f'/{self.node_name}/{suffix}'

    def start_node(self, nodes: NodeProcesses) -> None:
        """Start the node that looks at the bag's images."""
        renaming = ('--ros-args', '-r', f'__node:={self.node_name}')
        remapping = [word for end in _INPUTS for word in ('-r', f'{end}:=/{self.name}/{end}')]
        images = _losing_nothing([self.image_topic], 'subscription')
        results = _losing_nothing(map(self.topic, self.processor.topics), 'publisher')
        given = [word for n, v in self.parameters.items() for word in ('-p', f'{n}:={v}')]
        arguments = (*renaming, *remapping, *images, *results, *given)
        nodes.start('mvuav_ros', self.processor.name, *arguments)

    def start_source(self, nodes: NodeProcesses, **parameters: str) -> None:
        """Start the node that plays the bag."""
        given = {'source': self.bag, **parameters}
        arguments = [word for name in given for word in ('-p', f'{name}:={given[name]}')]
        images = _losing_nothing([self.image_topic], 'publisher')
        remapping = ('--ros-args', '-r', f'__ns:=/{self.name}')
        nodes.start('mvuav_ros', 'video_source', *remapping, *images, *arguments)


def _losing_nothing(topics: Iterable[str], end: str) -> list[str]:
    """Arguments by which a publisher or subscription keeps all, however busy the machine is."""
    policies = {'reliability': 'reliable', 'history': 'keep_all'}
    overrides = [
        f'qos_overrides.{topic}.{end}.{policy}:={value}'
        for topic in topics
        for policy, value in policies.items()
    ]
    return [word for override in overrides for word in ('-p', override)]


def sample_flights(bags: Path, *, with_thesis: bool = False) -> list[SampleFlight]:
    """One node for each sample bag in a folder, and perhaps the thesis's runway scheme beside.

    Raises:
        SourceError: there are none.
    """
    tanker, runway = bags / 'tanker.mcap', bags / 'runway.mcap'
    # The bag has a calibration; the width of its runway makes a pose of the lines.
    approach: dict[str, Value] = {'mode': 'approach', 'runway_width': 30.0}
    flights = [
        SampleFlight(tanker, MarkerTrackerProcessor, 'marker_tracker', title='five lights'),
        SampleFlight(runway, RunwayDetectorProcessor, 'runway_detector', approach, 'approach'),
    ]
    if with_thesis:
        thesis = SampleFlight(runway, RunwayDetectorProcessor, 'runway_thesis', title='thesis')
        flights.append(thesis)
    present = [flight for flight in flights if flight.bag.is_file()]
    if not present:
        raise SourceError(f'{bags}: no sample bags there')
    return present

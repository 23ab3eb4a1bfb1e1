"""What the demo shows: for each sample bag its node, topics, table and figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from mvuav_ros.cli.processes import NodeProcesses
from mvuav_ros.messages.images import IMAGE
from mvuav_ros.messages.points import view_points as decode_points
from mvuav_ros.processing.marker_processor import MarkerTrackerProcessor
from mvuav_ros.processing.processor import Processor
from mvuav_ros.processing.runway_processor import RunwayDetectorProcessor
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.sources.source import SourceError
from mvuav_ros.vision.markers.results import Label, MarkerState
from mvuav_ros.vision.runway.results import LineFlag


@dataclass(frozen=True)
class Flight:
    """A sample bag and the node that looks at it.

    Attributes:
        bag: the file, whose name is the namespace of its images.
        processor: the node.
        main_topic: result topic that has one message per frame.
        make_table: from the newest message of each topic below ``~/`` what the terminal shows.
    """

    bag: Path
    processor: type[Processor]
    main_topic: str
    make_table: Callable[[dict[str, Any]], Table]

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
    def node(self) -> str:
        """The node's fully qualified name."""
        return f'/{self.processor.name}'

    @property
    def main(self) -> str:
        """The full name of the main topic."""
        return self.topic(self.main_topic)

    def topic(self, suffix: str) -> str:
        """A result topic's full name."""
        return f'{self.node}/{suffix}'

    def start_node(self, nodes: NodeProcesses, **parameters: str) -> None:
        """Start the node that looks at the bag's images, with some parameters."""
        remapping = ('--ros-args', '-r', f'image_raw:={self.image_topic}')
        images = _losing_nothing([self.image_topic], 'subscription')
        results = _losing_nothing(map(self.topic, self.processor.topics), 'publisher')
        given = [word for name in parameters for word in ('-p', f'{name}:={parameters[name]}')]
        nodes.start('mvuav_ros', self.processor.name, *remapping, *images, *results, *given)

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


def marker_table(newest: dict[str, Any]) -> Table:
    """Five markers and the roll."""
    colors = {MarkerState.DETECTED: 'green', MarkerState.PREDICTED: 'yellow'}
    table = _table('marker', 'state', 'x px', 'y px', 'vx px/s', 'vy px/s')
    for row in decode_points(newest['markers']) if 'markers' in newest else ():
        state = MarkerState(row['state'])
        table.add_row(
            Label(row['label']).name.lower(),
            f'[{colors.get(state, "red")}]{state.name.lower()}[/]',
            *(_number(row[name]) for name in ('x', 'y', 'vx', 'vy')),
        )
    if 'rpy' in newest:
        table.caption = f'roll {_number(math.degrees(newest["rpy"].vector.x))}°'
    return table


def runway_table(newest: dict[str, Any]) -> Table:
    """One row per line, with its flags."""
    table = _table('line', 'state', 'rho px', 'theta °', 'votes')
    rows = decode_points(newest['line_params']) if 'line_params' in newest else ()
    for index, row in enumerate(rows, 1):
        words = _flag_words(int(row['flags'])) if np.isfinite(row['rho']) else '[red]not found[/]'
        numbers = (row['rho'], math.degrees(row['theta']), row['votes'])
        table.add_row(str(index), words, *map(_number, numbers))
    return table


def _flag_words(flags: int) -> str:
    if not flags & LineFlag.CORRECTED:
        return '[green]ok[/]'
    names = ['rho'] * bool(flags & LineFlag.RHO_ERROR)
    names += ['theta'] * bool(flags & LineFlag.THETA_ERROR)
    return f'[yellow]{" and ".join(names)} corrected[/]'


def _table(*headings: str) -> Table:
    table = Table(box=None, pad_edge=False, caption_justify='left')
    for index, heading in enumerate(headings):
        table.add_column(heading, justify='left' if index < 2 else 'right', min_width=9)
    return table


def _number(value: float) -> str:
    return '-' if math.isnan(value) else f'{value:.1f}'


def sample_flights(bags: Path) -> list[Flight]:
    """The flights whose bags lie in a folder.

    Raises:
        SourceError: there are none.
    """
    flights = [
        Flight(bags / 'tanker.mcap', MarkerTrackerProcessor, 'markers', marker_table),
        Flight(bags / 'runway.mcap', RunwayDetectorProcessor, 'line_params', runway_table),
    ]
    present = [flight for flight in flights if flight.bag.is_file()]
    if not present:
        raise SourceError(f'{bags}: no sample bags there')
    return present

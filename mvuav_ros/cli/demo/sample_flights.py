"""What the demo shows: for each node its sample bag, topics and table."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from mvuav_ros.cli.node_processes import NodeProcesses
from mvuav_ros.messages.cdr import view_points
from mvuav_ros.messages.images import IMAGE
from mvuav_ros.processing.marker_processor import MarkerTrackerProcessor
from mvuav_ros.processing.processor import Processor
from mvuav_ros.processing.runway_processor import RunwayDetectorProcessor
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.sources.source import SourceError
from mvuav_ros.vision.markers.marker_results import Label, MarkerState
from mvuav_ros.vision.runway.results import LineFlag, LineRole

_INPUTS = ('image_raw', 'camera_info')
_SIDES = {LineRole.LEFT_EDGE: 'left edge', LineRole.RIGHT_EDGE: 'right edge'}


@dataclass(frozen=True)
class SampleFlight:
    """A sample bag, whose name is the namespace of its images, and the node that looks at it.

    ``make_table`` makes what the terminal shows, from the newest message of each topic below
    ``~/``; ``title`` is shown behind the node's name.
    """

    bag: Path
    processor: type[Processor]
    node_name: str
    make_table: Callable[[dict[str, Any]], Table]
    parameters: dict[str, str] = field(default_factory=dict)
    title: str = ''

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
        return f'/{self.node_name}'

    @property
    def main(self) -> str:
        """The full name of the topic that has one message per frame."""
        return self.topic(self.processor.panel.known_by)

    def topic(self, suffix: str) -> str:
        """A result topic's full name."""
        return f'{self.node}/{suffix}'

    def start_node(self, nodes: NodeProcesses) -> None:
        """Start the node that looks at the bag's images."""
        renaming = ('--ros-args', '-r', f'__node:={self.node_name}')
        remapping = [word for end in _INPUTS for word in ('-r', f'{end}:=/{self.name}/{end}')]
        images = _losing_nothing([self.image_topic], 'subscription')
        results = _losing_nothing(map(self.topic, self.processor.topics), 'publisher')
        given = [word for item in self.parameters.items() for word in ('-p', ':='.join(item))]
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


def marker_table(newest: dict[str, Any]) -> Table:
    """Five markers and the roll."""
    colors = {MarkerState.DETECTED: 'green', MarkerState.PREDICTED: 'yellow'}
    table = _table('marker', 'state', 'x px', 'y px', 'vx px/s', 'vy px/s')
    for row in view_points(newest['markers']) if 'markers' in newest else ():
        state = MarkerState(row['state'])
        table.add_row(
            Label(row['label']).name.lower(),
            f'[{colors.get(state, "red")}]{state.name.lower()}[/]',
            *(_number(row[name]) for name in ('x', 'y', 'vx', 'vy')),
        )
    if 'rpy' in newest:
        table.caption = f'roll {_number(math.degrees(newest["rpy"].vector.x))}°'
    return table


def approach_table(newest: dict[str, Any]) -> Table:
    """The runway's two edges, and where the aircraft is."""
    table = _table('line', 'confidence', 'far end x, y px', 'near end x, y px')
    for row in view_points(newest['line_params']) if 'line_params' in newest else ():
        if row['role'] in _SIDES:
            sure = '-' if math.isnan(row['confidence']) else f'{100 * row["confidence"]:.0f} %'
            ends = (
                ', '.join(map(_number, (row[x], row[y]))) for x, y in (('x', 'y'), ('x2', 'y2'))
            )
            table.add_row(_SIDES[LineRole(row['role'])], sure, *ends)
    if 'pose' in newest:
        place = newest['pose'].pose.pose.position
        if math.isfinite(place.y):
            side = 'left' if place.y > 0 else 'right'
            table.caption = f'{abs(place.y):.1f} m {side} of the centreline, {place.z:.1f} m high'
    return table


def thesis_table(newest: dict[str, Any]) -> Table:
    """One row per line, with its flags."""
    table = _table('line', 'state', 'rho px', 'theta °', 'votes')
    rows = view_points(newest['line_params']) if 'line_params' in newest else ()
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


def sample_flights(bags: Path, *, with_thesis: bool = False) -> list[SampleFlight]:
    """One node for each sample bag in a folder, and perhaps the thesis's runway scheme beside.

    Raises:
        SourceError: there are none.
    """
    tanker, runway = bags / 'tanker.mcap', bags / 'runway.mcap'
    # The bag has a calibration; the width of its runway makes a pose of the lines.
    approach = {'mode': 'approach', 'runway_width': '30.0'}
    flights = [
        SampleFlight(
            *(tanker, MarkerTrackerProcessor, 'marker_tracker', marker_table), title='five lights'
        ),
        SampleFlight(
            *(runway, RunwayDetectorProcessor, 'runway_detector', approach_table),
            parameters=approach,
            title='approach',
        ),
    ]
    if with_thesis:
        thesis = (runway, RunwayDetectorProcessor, 'runway_thesis', thesis_table)
        flights.append(SampleFlight(*thesis, title='thesis'))
    present = [flight for flight in flights if flight.bag.is_file()]
    if not present:
        raise SourceError(f'{bags}: no sample bags there')
    return present

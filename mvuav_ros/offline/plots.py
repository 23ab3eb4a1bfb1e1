"""Results as pictures: a page for each flight, and one overview of all of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch
from numpy.typing import NDArray

from mvuav_ros.messages.cdr import stamp_ns_in
from mvuav_ros.messages.untrusted import MalformedMessageError, visible
from mvuav_ros.offline.report_figures import COLORS, Canvas, drawing, line_of
from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.reading import Recording, open_recording
from mvuav_ros.recordings.remote import write_whole
from mvuav_ros.recordings.result_rows import ResultRows
from mvuav_ros.vision.image import ImageError
from mvuav_ros.vision.runway.results import LineRole

Array = NDArray[np.float64]

OVERVIEW, OTHER_OVERVIEW = 'overview.png', 'overview_of_all.png'
_MAX_POINTS = 3000
"""Along the time axis: a page has fewer px."""
_MAX_STATES = 600
"""Likewise: the page has more px, as a bar narrower than one may not be drawn at all."""
_SIGMAS = 2.0
"""Standard deviations of the bounds that are drawn, 95 %."""
_STATES = ('detected', 'predicted', 'lost')
_LOST = 2
_SEVERITY = {1: 0, 2: 1, 0: _LOST}
"""Of a marker's state: an index into `_STATES`, the worst last."""
_BESIDE: Any = {'loc': 'upper left', 'bbox_to_anchor': (1.0, 1.0)}
"""Where a diagram's legend stands."""
_LEGEND_ROWS = 10
_STATE_COLORS = ('#4477aa', '#ddaa33', '#d0d0d0')
_FROM_ZERO = {'lines found': 5.5, 'confidence': 1.05, 'lights': 1.0}
"""Diagrams that begin at zero, and how far they reach at least."""


class Diagram(NamedTuple):
    """One of a page: height (inches), title, topic, and curves.

    Each curve has a name, its column, and the column of its bound, which may be empty: columns of
    `ResultRows`, and what `_take` makes of them.
    """

    height: float
    title: str
    topic: str
    lines: tuple[tuple[str, str, str], ...]


_ROLES = {role.name.lower(): role.name.lower().replace('_', ' ') for role in LineRole if role}


def _line(number: int, role: str = '') -> str:
    return _ROLES.get(role, f'line {number}')


def _levels(*names: str) -> Diagram:
    limits = ((f'limit {name}', f'alert_limit_{name}', '') for name in names)
    lines = (*((name, name, '') for name in names), *limits)
    return Diagram(1.5, 'protection level [m]', 'integrity', lines)


_MAX_LINES = 100  # Of `num_peaks`
_THETA = Diagram(
    1.9,
    'theta [°]',
    'line_params',
    tuple((name, name, '') for name in (*_ROLES.values(), *map(_line, range(1, _MAX_LINES + 1)))),
)
_RUNWAY = (
    Diagram(1.7, 'lateral offset [m]', 'pose', (('left of the centreline', 'y', 'bound_y'),)),
    Diagram(1.7, 'height [m]', 'pose', (('above the runway', 'z', 'bound_z'),)),
    Diagram(1.7, 'heading [°]', 'pose', (('nose left of the runway', 'yaw_deg', 'bound_rz'),)),
    _levels('offset', 'height'),
    _THETA,
    Diagram(1.1, 'lines found', 'line_params', (('lines', 'lines', ''),)),
    Diagram(1.1, 'confidence', 'line_params', (('confidence', 'confidence', ''),)),
)
_MARKERS = (
    Diagram(1.7, 'roll [°]', 'rpy', (('roll', 'roll_deg', ''),)),
    Diagram(1.7, 'pitch, yaw [°]', 'rpy', (('pitch', 'pitch_deg', ''), ('yaw', 'yaw_deg', ''))),
    Diagram(1.7, 'distance ahead [m]', 'pose', (('z', 'z', 'bound_z'),)),
    Diagram(1.7, 'beside [m]', 'pose', (('x, right', 'x', 'bound_x'), ('y, down', 'y', 'bound_y'))),
    Diagram(1.3, '95 % [± m]', 'pose', tuple((name, f'bound_{name}', '') for name in 'zxy')),
    _levels('along', 'across', 'up'),
    Diagram(1.3, 'lights', 'markers', (('tracked', 'lights', ''),)),
)


def _columns(is_runway: bool) -> dict[str, list[str]]:
    columns: dict[str, list[str]] = {}
    for diagram in _RUNWAY if is_runway else _MARKERS:
        for _, column, bound in diagram.lines:
            columns.setdefault(diagram.topic, []).extend(filter(None, (column, bound)))
    return columns


class Curves:
    """Numbers over time; of some frames of a long flight the middle one, least and greatest."""

    def __init__(self, names: Sequence[str], messages: int) -> None:
        """Begin curves of these names for about so many messages."""
        self._names = ('seconds', *names)
        self._at_once = max(1, math.ceil(messages / _MAX_POINTS))
        self._pending: list[list[float]] = []
        self._groups: list[Array] = []

    def add(self, seconds: float, values: Mapping[str, Any]) -> None:
        """Take what one message says; it need not say everything."""
        self._pending.append([seconds, *(values.get(name, math.nan) for name in self._names[1:])])
        if len(self._pending) >= self._at_once:
            self._close_group()

    def _close_group(self) -> None:
        rows = np.array(self._pending, np.float64)
        self._pending.clear()
        rows[~np.isfinite(rows)] = np.nan
        counts = np.isfinite(rows).sum(axis=0)
        # No mean: that of angles about 180 degrees is 0. NaN is sorted to the end.
        middle = np.sort(rows, axis=0)[np.maximum(counts - 1, 0) // 2, np.arange(counts.size)]
        self._groups.append(np.stack([middle, np.fmin.reduce(rows), np.fmax.reduce(rows)]))

    def by_name(self) -> dict[str, Array]:
        """(3, n) each: middle, least and greatest, also of the time, ``seconds``."""
        if self._pending:
            self._close_group()
        whole = np.array(self._groups).reshape(-1, 3, len(self._names))
        return {name: whole[:, :, column].T for column, name in enumerate(self._names)}


@dataclass
class NodePart:
    """What one node says of a flight."""

    node: str
    is_runway: bool  # else it is of markers
    curves: dict[str, Curves] = field(default_factory=dict)  # of each topic, by its last word
    names: list[str] = field(default_factory=list)  # of the markers
    # Of each group of `at_once` frames the worst states of the names by then, in `_STATES`.
    states: list[list[int]] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    counts: list[int] = field(default_factory=lambda: [0, 0, 0])  # markers in frames, by state
    frames: int = 0
    poses: int = 0  # frames with one
    at_once: int = 1
    # Least, median and greatest of what the overview draws, once the page is drawn.
    extent: tuple[float, float, float] = (math.nan,) * 3

    @property
    def kind(self) -> str:
        """One of `_EXTENTS`."""
        return 'runway' if self.is_runway else 'markers' if any(self.counts) else 'lights'


@dataclass
class FlightPlot:
    """One flight's numbers: its name, its length (s), and what each node says."""

    name: str
    seconds: float = 0.0
    parts: list[NodePart] = field(default_factory=list)


def plot(flights: Mapping[str, Path], folder: Path, *, overwrite: bool = False) -> list[Path]:
    """Draw a page for each flight that has something to draw, and an overview, as PNG.

    Recordings of results are given by the names of their flights.

    Raises:
        RecordingError: there is nothing to draw, or a file exists.
    """
    paths = [folder / f'{flight}.png' for flight in flights]
    # A flight may have that name.
    paths.append(folder / OVERVIEW if folder / OVERVIEW not in paths else folder / OTHER_OVERVIEW)
    for path in paths:
        if path.exists() and not overwrite:
            raise RecordingError(f'{path} exists; choose another folder, or overwrite it (--force)')
    drawn: dict[Path, FlightPlot] = {}
    for (flight, source), path in zip(flights.items(), paths, strict=False):
        with open_recording(source) as recording:
            collected = collect(recording, flight)
            if not collected.parts:
                recording.account.note('plot', f'{source} holds no results that can be drawn')
                continue
        write_whole(path, page(collected).png)
        _summarise(collected)
        drawn[path] = collected
    if not drawn:
        names = ', '.join(map(str, flights.values()))
        raise RecordingError(f'{names} holds no results that can be drawn')
    write_whole(paths[-1], overview([*drawn.values()]).png)
    return [*drawn, paths[-1]]


_NEEDS = {'markers': {'label', 'state', 'name'}, 'line_params': {'x', 'theta_deg'}}
"""Columns without which a topic of that name is another program's."""


def collect(recording: Recording, flight: str) -> FlightPlot:
    """Read what can be drawn; it takes the same memory for a flight of any length."""
    rows = ResultRows(recording, flight)
    parts: dict[str, NodePart] = {}
    wanted: dict[str, tuple[NodePart, str]] = {}
    sizes = {topic.name: topic.message_count for topic in recording.topics}
    # What is said of markers stands above.
    for topic in sorted(rows.kinds, key=lambda topic: topic.endswith('/line_params')):
        node, _, kind = topic.rpartition('/')
        if kind not in ('markers', 'line_params') or node.endswith('/truth'):
            continue
        part = parts[node] = NodePart(node.strip('/') or 'results', kind == 'line_params')
        messages = sizes[topic]
        if messages is None:
            messages = sum(1 for _ in recording.messages({topic}))
        part.at_once = max(1, math.ceil(messages / _MAX_STATES))
        for other, names in _columns(part.is_runway).items():
            if f'{node}/{other}' in rows.kinds:
                wanted[f'{node}/{other}'] = part, other
                part.curves[other] = Curves(names, messages)
    stamps: list[int] = []
    for message in recording.messages(wanted):
        part, kind = wanted[message.topic]
        try:
            columns, values = rows.of(message)
            if not _NEEDS.get(kind, set()) <= set(columns):
                continue
            points = [dict(zip(columns, row, strict=True)) for row in values]
            stamp_ns = stamp_ns_in(message.data)
        except (MalformedMessageError, ImageError):
            continue
        # The first, the earliest and the latest, which may be any where clocks jump.
        first, earliest, latest = stamps or [stamp_ns] * 3
        stamps = [first, min(earliest, stamp_ns), max(latest, stamp_ns)]
        _take(part, kind, (stamp_ns - first) * 1e-9, points)
    length = (max(stamps, default=0) - min(stamps, default=0)) * 1e-9
    return FlightPlot(visible(flight), length, [part for part in parts.values() if part.frames])


def _take(part: NodePart, topic: str, seconds: float, points: list[dict[str, Any]]) -> None:
    said = points[0] if points else {}
    if topic == 'markers':
        part.frames += 1
        if points and not any('id' in of or of.get('label') == 255 for of in points):
            _take_markers(part, seconds, points)
            return
        # Without names there is nothing to withhold: how many lights there are.
        said = {'lights': len(points)}
    elif topic == 'line_params':
        part.frames += 1
        best = (of.get('confidence', math.nan) for of in points)
        said = {
            'confidence': max(filter(math.isfinite, best), default=math.nan),
            'lines': sum(math.isfinite(of['x']) for of in points),
            **{_line(n, of['role_name']): of['theta_deg'] for n, of in enumerate(points, 1)},
        }
    elif topic == 'pose':
        part.poses += math.isfinite(said['z'])
        for axis, unit in (('x', 1.0), ('y', 1.0), ('z', 1.0), ('rz', math.degrees(1.0))):
            variance = said.get(f'cov_{axis}_{axis}', math.nan)
            if 0 <= variance < 1e6:
                said[f'bound_{axis}'] = _SIGMAS * math.sqrt(variance) * unit
    part.curves[topic].add(seconds, said)


def _take_markers(part: NodePart, seconds: float, points: list[dict[str, Any]]) -> None:
    found = {}
    for of in points:
        severity = _SEVERITY.get(of['state'], _LOST)
        found[of['name'] or f'marker {of["label"]}'] = severity
        part.counts[severity] += 1
    # The rig may change in the middle of a recording.
    part.names += [name for name in found if name not in part.names]
    severities = [found.get(name, _LOST) for name in part.names]
    if (part.frames - 1) % part.at_once == 0:
        part.times.append(seconds)
        part.states.append(severities)
    else:
        worst = part.states[-1]
        part.states[-1] = [*map(max, worst, severities), *severities[len(worst) :]]


def page(flight: FlightPlot) -> Canvas:
    """One flight's page."""
    panels = [panel for part in flight.parts for panel in _panels(part)]
    heights = [height for height, _ in panels]
    with drawing(11.0, 1.0 + sum(heights)) as canvas:
        axes = canvas.figure.subplots(
            len(panels), 1, sharex=True, squeeze=False, height_ratios=heights
        )[:, 0]
        for axis, (_, draw) in zip(axes, panels, strict=True):
            draw(axis)
            axis.margins(x=0)
        axes[-1].set_xlabel('time [s]')
        words = ', '.join(_words(part) for part in flight.parts)
        canvas.figure.suptitle(f'{flight.name}: {flight.seconds:.1f} s\n{words}', fontsize='medium')
    return canvas


def _words(part: NodePart) -> str:
    posed = f'{part.node}: pose in {part.poses} of {part.frames} frames'
    named, total = part.counts[0] + part.counts[1], sum(part.counts)
    return f'{posed}, names in {100 * named / total:.1f} %' if total else posed


def _panels(part: NodePart) -> Iterator[tuple[float, Callable[[Axes], None]]]:
    """Heights (inches) of a node's diagrams with something in them, and what draws each."""
    given = {topic: curves.by_name() for topic, curves in part.curves.items()}
    for diagram in _RUNWAY if part.is_runway else _MARKERS:
        curves = given.get(diagram.topic, {})
        columns = [column for _, column, _ in diagram.lines if column in curves]
        # The angles of the lines matter where they make no pose.
        if diagram is _THETA and part.poses:
            continue
        if any(np.isfinite(curves[column][0]).any() for column in columns):
            yield diagram.height, partial(_draw, diagram=diagram, curves=curves)
    if part.states:
        yield 0.5 + 0.22 * len(part.names), partial(_draw_states, part=part)


def _draw(axis: Axes, diagram: Diagram, curves: Mapping[str, Array]) -> None:
    seconds = curves['seconds'][0]
    # A line would run back over those of before.
    goes_back = np.diff(seconds, prepend=seconds[:1]) < 0.0
    for name, column, bound in diagram.lines:
        middle, low, high = np.where(goes_back, math.nan, curves[column])
        if not np.isfinite(middle).any():
            continue
        if bound:
            spread = np.nan_to_num(curves[bound][0])
            low, high = low - spread, high + spread
        look = line_of(len(axis.lines))
        axis.fill_between(seconds, low, high, color=look['color'], alpha=0.25, linewidth=0)
        # A single frame between two gaps is a point.
        axis.plot(seconds, middle, **look, label=name, linewidth=1.0, marker='.', markersize=2)
    axis.set_ylabel(diagram.title)
    if diagram.title in _FROM_ZERO:
        highest = float(np.nanmax(curves[diagram.lines[0][1]][0]))
        axis.set_ylim(0, max(_FROM_ZERO[diagram.title], 1.05 * highest))
    axis.legend(**_BESIDE, ncols=-(-len(axis.lines) // _LEGEND_ROWS))


def _draw_states(axis: Axes, part: NodePart) -> None:
    lost = [_LOST] * len(part.names)
    states = np.array([[*row, *lost[len(row) :]] for row in part.states]).T
    times = np.array(part.times)
    steps = np.diff(times)
    step = float(np.median(steps)) if len(steps) else 1.0
    # Bars from each frame to the next one, also where frames are missing.
    edges = np.append(times, times[-1] + step)
    rows, colors = np.arange(len(part.names) + 1), ListedColormap(_STATE_COLORS)
    axis.pcolormesh(edges, rows, states, cmap=colors, vmin=-0.5, vmax=2.5, rasterized=True)
    axis.hlines(rows[1:-1], edges[0], edges[-1], color='white', linewidth=2)
    axis.set_yticks(rows[:-1] + 0.5, part.names, fontsize='small')
    axis.invert_yaxis()
    axis.legend(handles=_states_key(), **_BESIDE)


def _states_key() -> list[Patch]:
    return [Patch(color=c, label=s) for c, s in zip(_STATE_COLORS, _STATES, strict=True)]


_EXTENTS = {
    'markers': ('rpy', 'roll_deg', 'roll [°]'),
    'lights': ('markers', 'lights', 'lights without names'),
    'runway': ('pose', 'z', 'height [m]'),
}
"""Topic, column and words of what the overview draws of each kind of part."""


def _summarise(flight: FlightPlot) -> None:
    """Keep what the overview draws; it needs the numbers of the page no more."""
    for part in flight.parts:
        topic, column, _ = _EXTENTS[part.kind]
        if topic in part.curves:
            middle, least, greatest = part.curves[topic].by_name()[column]
            if np.isfinite(middle).any():
                part.extent = np.nanmin(least), float(np.nanmedian(middle)), np.nanmax(greatest)
        part.curves, part.states, part.times = {}, [], []


def overview(flights: Sequence[FlightPlot]) -> Canvas:
    """All flights on one page: a line for each."""
    columns: list[tuple[str, Callable[[Axes, int, NodePart], None]]] = []
    for kind in _EXTENTS:
        own = [part for flight in flights for part in flight.parts if part.kind == kind]
        if own and kind != 'lights':
            columns.append((kind, _draw_shares))
        if any(math.isfinite(part.extent[1]) for part in own):
            columns.append((kind, _draw_extent))
    with drawing(3.0 + 4.0 * len(columns), 1.8 + 0.3 * len(flights)) as canvas:
        axes = canvas.figure.subplots(1, len(columns), sharey=True, squeeze=False)[0]
        for axis, (kind, draw) in zip(axes, columns, strict=True):
            for row, flight in enumerate(flights):
                for part in flight.parts:
                    if part.kind == kind:
                        draw(axis, row, part)
            if draw is _draw_extent:
                axis.set_xlabel(f'{_EXTENTS[kind][2]}: least, median, greatest')
                continue
            axis.set_xlim(0, 100)
            is_runway = kind == 'runway'
            axis.set_xlabel('frames with a pose [%]' if is_runway else 'markers and poses [%]')
            if is_runway:
                axis.set_title('runway')
            else:
                key = [*_states_key(), Patch(color=COLORS[2], label='frames with a pose')]
                axis.legend(handles=key, loc='lower left', bbox_to_anchor=(0.0, 1.0), ncols=2)
        names = [f'{flight.name}  {flight.seconds:.0f} s' for flight in flights]
        axes[0].set_yticks(range(len(flights)), names, fontsize='small')
        axes[0].set_ylim(len(flights) - 0.5, -0.5)
    return canvas


def _draw_shares(axis: Axes, row: int, part: NodePart) -> None:
    left, total = 0.0, max(sum(part.counts), 1)
    for count, color in zip(part.counts, _STATE_COLORS, strict=True):
        width = 100.0 * count / total
        axis.barh(row - 0.15, width, 0.4, left, color=color)
        left += width
    axis.barh(row + 0.2, 100.0 * part.poses / max(part.frames, 1), 0.2, color=COLORS[2])


def _draw_extent(axis: Axes, row: int, part: NodePart) -> None:
    least, median, greatest = part.extent
    axis.plot([least, greatest], [row, row], color=COLORS[0], linewidth=2)
    axis.plot(median, row, 'o', color=COLORS[0], markersize=5)

"""Results as pictures: a page for each flight, and one overview of all of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from mvuav_ros.messages.untrusted import MalformedMessageError
from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.reading import Recording, open_recording
from mvuav_ros.recordings.remote import write_whole
from mvuav_ros.recordings.tables import ResultRows

Array = NDArray[np.float64]

OVERVIEW = 'overview.png'
_MAX_POINTS = 3000
"""Along the time axis: a page has fewer px."""
_SIGMAS = 2.0
"""Standard deviations of the bounds that are drawn, 95 %."""
_STATES = ('seen', 'predicted', 'withheld or lost')
_SEVERITY = {1: 0, 2: 1, 0: 2}
"""Of a marker's state: an index into `_STATES`, the worst last."""
_STATE_COLORS = ('#4477aa', '#ddaa33', '#d0d0d0')
_COLORS = ('#4477aa', '#cc6677', '#228833', '#aa3377', '#66ccee', '#ccbb44')
_ANGLES = ('roll_deg', 'pitch_deg', 'yaw_deg')
_DEGREES = 180.0 / math.pi
_FROM_ZERO = {'lines found': 5.5, 'confidence': 1.05, 'lights': 1.0}
"""Diagrams that begin at zero, and how far they reach at least."""


class Curves:
    """Numbers over time; of a long flight the mean, least and greatest of some frames at a time."""

    def __init__(self, count: int, messages: int) -> None:
        """Begin so many curves for about so many messages."""
        self._at_once = max(1, math.ceil(messages / _MAX_POINTS))
        self._pending: list[Sequence[float]] = []
        self._groups: list[Array] = []
        self._count = count

    def add(self, seconds: float, values: Sequence[float]) -> None:
        """Take what one message says."""
        self._pending.append((seconds, *values))
        if len(self._pending) >= self._at_once:
            self._close_group()

    def _close_group(self) -> None:
        rows = np.array(self._pending, np.float64)
        self._pending.clear()
        known = np.isfinite(rows)
        counts = np.maximum(known.sum(axis=0), 1)
        mean = np.where(known.any(axis=0), np.where(known, rows, 0.0).sum(axis=0) / counts, np.nan)
        least = np.where(known, rows, np.inf).min(axis=0)
        greatest = np.where(known, rows, -np.inf).max(axis=0)
        group = np.stack([mean, least, greatest])
        self._groups.append(np.where(np.isfinite(group), group, np.nan))

    def array(self) -> Array:
        """(3, n, 1 + count): mean, least and greatest of the time (s) and each curve."""
        if self._pending:
            self._close_group()
        if not self._groups:
            return np.full((3, 0, 1 + self._count), np.nan)
        return np.stack(self._groups, axis=1)


@dataclass
class NodePart:
    """What one node says of a flight.

    Attributes:
        node: its name.
        is_runway: whether it is of a runway, else of markers.
        curves: the numbers of each topic, by its last word.
        names: of the markers, in the order of their states.
        states: (markers, n), the worst state in each group of frames, an index into `_STATES`.
        counts: markers in frames, by state.
        frames: how many there were.
        poses: frames with a pose.
    """

    node: str
    is_runway: bool
    curves: dict[str, Curves] = field(default_factory=dict)
    names: list[str] = field(default_factory=list)
    states: list[list[int]] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    counts: list[int] = field(default_factory=lambda: [0, 0, 0])
    frames: int = 0
    poses: int = 0
    at_once: int = 1


@dataclass
class FlightPlot:
    """One flight's numbers: its name, its length (s), and what each node says."""

    name: str
    seconds: float = 0.0
    parts: list[NodePart] = field(default_factory=list)


def plot(flights: Mapping[str, Path], folder: Path, *, overwrite: bool = False) -> list[Path]:
    """Draw a page for each flight and an overview, as PNG.

    Args:
        flights: recordings of results by the names of their flights.
        folder: where the pictures go; it is made.
        overwrite: replace files that exist.

    Raises:
        RecordingError: there is nothing to draw, or a file exists.
    """
    paths = [folder / f'{flight}.png' for flight in flights] + [folder / OVERVIEW]
    for path in paths:
        if path.exists() and not overwrite:
            raise RecordingError(f'{path} exists; choose another folder, or overwrite it (--force)')
    drawn = []
    for (flight, source), path in zip(flights.items(), paths, strict=False):
        with open_recording(source) as recording:
            collected = collect(recording, flight)
        if not collected.parts:
            raise RecordingError(f'{source} holds no results that can be drawn')
        _save(page(collected), path)
        # The overview needs the numbers of a page no more.
        drawn.append(_summary(collected))
    _save(overview(drawn), paths[-1])
    return paths


def collect(recording: Recording, flight: str) -> FlightPlot:
    """Read what can be drawn; it takes the same memory for a flight of any length."""
    rows = ResultRows(recording, flight)
    parts: dict[str, NodePart] = {}
    wanted: dict[str, tuple[NodePart, str]] = {}
    sizes = {topic.name: topic.message_count for topic in recording.topics}
    for kind, others in (
        ('markers', ('rpy', 'pose', 'integrity')),
        ('line_params', ('pose', 'integrity')),
    ):
        for topic in rows.kinds:
            node = topic.removesuffix(f'/{kind}')
            if node == topic or node.endswith('/truth'):
                continue
            part = parts[node] = NodePart(node.strip('/') or 'results', kind == 'line_params')
            messages = sizes[topic]
            if messages is None:
                messages = sum(1 for _ in recording.messages({topic}))
            part.at_once = max(1, math.ceil(messages / _MAX_POINTS))
            for other in (kind, *others):
                if f'{node}/{other}' in rows.kinds:
                    wanted[f'{node}/{other}'] = part, other
                    part.curves[other] = Curves(6, messages)
    first_ns = last_ns = 0
    for message in recording.messages(wanted):
        part, topic = wanted[message.topic]
        try:
            columns, values = rows.of(message)
            points = [dict(zip(columns, row, strict=True)) for row in values]
        except MalformedMessageError:
            continue
        if not points:
            continue
        stamp_ns = int(points[0]['stamp_ns'])
        first_ns = first_ns or stamp_ns
        last_ns = stamp_ns
        _take(part, topic, (stamp_ns - first_ns) * 1e-9, points)
    length = (last_ns - first_ns) * 1e-9
    return FlightPlot(flight, length, [part for part in parts.values() if part.frames])


def _take(part: NodePart, topic: str, seconds: float, points: list[dict[str, Any]]) -> None:
    curves = part.curves[topic]
    if topic == 'markers':
        _take_markers(part, seconds, points)
    elif topic == 'rpy':
        curves.add(seconds, [points[0][name] for name in _ANGLES] + [math.nan] * 3)
    elif topic == 'integrity':
        axes = ('offset', 'height') if part.is_runway else ('along', 'across', 'up')
        names = [*axes, *(f'alert_limit_{axis}' for axis in axes)]
        values = [points[0][name] for name in names]
        curves.add(seconds, values + [math.nan] * (6 - len(values)))
    elif topic == 'pose':
        of = points[0]
        part.poses += math.isfinite(of['z'])
        last = 'yaw_deg' if part.is_runway else 'x'
        variances = [
            of.get(f'cov_{a}_{a}', math.nan) for a in ('y', 'z', 'rz' if part.is_runway else 'x')
        ]
        sigmas = [math.sqrt(v) if 0 <= v < 1e6 else math.nan for v in variances]
        if part.is_runway:
            sigmas[2] *= _DEGREES
        curves.add(seconds, [of['y'], of['z'], of[last], *sigmas])
    else:
        part.frames += 1
        best = [of.get('confidence', math.nan) for of in points]
        lines = [of['theta_deg'] for of in points[:4]] + [math.nan] * 4
        known = [value for value in best if math.isfinite(value)]
        found = sum(math.isfinite(of['x']) for of in points)
        curves.add(seconds, [max(known, default=math.nan), found, *lines[:4]])


def _take_markers(part: NodePart, seconds: float, points: list[dict[str, Any]]) -> None:
    if any('id' in of or of.get('label') == 255 for of in points):
        # Without names there is nothing to withhold: how many lights there are.
        part.frames += 1
        part.curves['markers'].add(seconds, [len(points)] + [math.nan] * 5)
        return
    names = [of['name'] or f'marker {of["label"]}' for of in points]
    if not part.names:
        part.names = names
    severities = [_SEVERITY.get(int(of['state']), 2) for of in points][: len(part.names)]
    for severity in severities:
        part.counts[severity] += 1
    if part.frames % part.at_once == 0:
        part.times.append(seconds)
        part.states.append(severities)
    else:
        worst = part.states[-1]
        part.states[-1] = [max(pair) for pair in zip(worst, severities, strict=True)]
    part.frames += 1


def page(flight: FlightPlot) -> Figure:
    """One flight's page."""
    panels = [panel for part in flight.parts for panel in _panels(part)]
    heights = [height for height, _ in panels]
    figure = Figure(figsize=(11, 1.0 + sum(heights)), layout='constrained')
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    for axis, (_, draw) in zip(axes, panels, strict=True):
        draw(axis)
        axis.margins(x=0)
    axes[-1].set_xlabel('time [s]')
    words = ', '.join(_words(part) for part in flight.parts)
    figure.suptitle(f'{flight.name}: {flight.seconds:.1f} s\n{words}', fontsize='medium')
    return figure


def _words(part: NodePart) -> str:
    of = f'{part.node}: pose in {part.poses} of {part.frames} frames'
    total = sum(part.counts)
    return (
        f'{of}, names in {100 * (part.counts[0] + part.counts[1]) / total:.1f} %' if total else of
    )


def _panels(part: NodePart) -> list[tuple[float, Any]]:
    """Heights (inches) of a node's diagrams, and what draws each."""
    given = {topic: curves.array() for topic, curves in part.curves.items()}
    panels: list[tuple[float, Any]] = []

    def add(height: float, title: str, values: Array, *lines: tuple[str, int, int | None]) -> None:
        if np.isfinite(values[0][:, [column for _, column, _ in lines]]).any():
            panels.append((height, lambda axis: _draw(axis, title, values, lines)))

    def add_levels(*axes: str) -> None:
        if 'integrity' in given:
            lines = [(name, 1 + i, None) for i, name in enumerate(axes)]
            limits = [(f'limit {name}', 1 + len(axes) + i, None) for i, name in enumerate(axes)]
            known = np.isfinite(given['integrity'][0]).any(axis=0)
            add(
                1.5,
                'protection level [m]',
                given['integrity'],
                *lines,
                *(limit for limit in limits if known[limit[1]]),
            )

    if part.is_runway:
        pose = given.get('pose', np.full((3, 0, 7), np.nan))
        add(1.7, 'lateral offset [m]', pose, ('left of the centreline', 1, 4))
        add(1.7, 'height [m]', pose, ('above the runway', 2, 5))
        add(1.7, 'heading [°]', pose, ('nose left of the runway', 3, 6))
        add_levels('offset', 'height')
        lines = given['line_params']
        if not part.poses:
            angles = [(f'line {number}', 2 + number, None) for number in range(1, 5)]
            add(1.9, 'theta [°]', lines, *angles)
        add(1.1, 'lines found', lines, ('lines', 2, None))
        add(1.1, 'confidence', lines, ('confidence', 1, None))
        return panels
    if 'rpy' in given:
        add(1.7, 'roll [°]', given['rpy'], ('roll', 1, None))
        add(1.7, 'pitch, yaw [°]', given['rpy'], ('pitch', 2, None), ('yaw', 3, None))
    if 'pose' in given:
        add(1.7, 'distance ahead [m]', given['pose'], ('z', 2, 5))
        add(1.7, 'beside [m]', given['pose'], ('x, right', 3, 6), ('y, down', 1, 4))
        bounds = given['pose'].copy()
        bounds[:, :, 4:] *= _SIGMAS
        names = ('z', 5, None), ('x', 6, None), ('y', 4, None)
        add(1.3, '95 % [± m]', bounds, *names)
    add_levels('along', 'across', 'up')
    if part.states:
        panels.append((0.5 + 0.22 * len(part.names), lambda axis: _draw_states(axis, part)))
    else:
        add(1.3, 'lights', given['markers'], ('tracked', 1, None))
    return panels


def _draw(
    axis: Axes, title: str, values: Array, lines: Sequence[tuple[str, int, int | None]]
) -> None:
    mean, least, greatest = values
    seconds = mean[:, 0]
    for (name, column, sigma), color in zip(lines, _COLORS, strict=False):
        if not np.isfinite(mean[:, column]).any():
            continue
        low, high = least[:, column], greatest[:, column]
        if sigma is not None:
            spread = np.nan_to_num(_SIGMAS * mean[:, sigma])
            low, high = low - spread, high + spread
        axis.fill_between(seconds, low, high, color=color, alpha=0.25, linewidth=0)
        # A single frame between two gaps is a point.
        axis.plot(
            seconds,
            mean[:, column],
            color=color,
            label=name,
            linewidth=1.0,
            marker='.',
            markersize=2,
        )
    axis.set_ylabel(title)
    if title in _FROM_ZERO:
        axis.set_ylim(0, max(_FROM_ZERO[title], 1.05 * float(np.nanmax(mean[:, lines[0][1]]))))
    axis.grid(alpha=0.3)
    _add_legend(axis, None, (1.0, 1.0))


def _draw_states(axis: Axes, part: NodePart) -> None:
    states = np.array(part.states).T
    times = np.array(part.times)
    steps = np.diff(times)
    step = float(np.median(steps)) if len(steps) else 1.0
    # Bars from each frame to the next one, also where frames are missing.
    edges = np.append(times, times[-1] + step)
    axis.pcolormesh(
        edges,
        np.arange(len(part.names) + 1),
        states,
        cmap=ListedColormap(_STATE_COLORS),
        vmin=-0.5,
        vmax=2.5,
        rasterized=True,
    )
    axis.hlines(np.arange(1, len(part.names)), edges[0], edges[-1], color='white', linewidth=2)
    axis.set_yticks(np.arange(len(part.names)) + 0.5, part.names, fontsize='small')
    axis.invert_yaxis()
    _add_legend(axis, _states_key(), (1.0, 1.0))


def _states_key() -> list[Patch]:
    return [Patch(color=c, label=s) for c, s in zip(_STATE_COLORS, _STATES, strict=True)]


def _add_legend(
    axis: Axes, handles: Sequence[Artist] | None, corner: tuple[float, float], columns: int = 1
) -> None:
    """Of these handles, or of what is drawn, beside a corner of the diagram."""
    axis.legend(
        handles=handles,
        loc='upper left' if corner[0] else 'lower left',
        bbox_to_anchor=corner,
        ncols=columns,
        fontsize='small',
        frameon=False,
    )


@dataclass
class NodeSummary:
    """A line of the overview: of each node its part, and the quartiles of what is drawn."""

    name: str
    parts: list[tuple[NodePart, Array]]


def _summary(flight: FlightPlot) -> NodeSummary:
    parts = []
    for part in flight.parts:
        topic, column = ('pose', 2) if part.is_runway else ('rpy', 1)
        curves = part.curves.get(topic)
        values = curves.array() if curves else np.full((3, 0, 7), np.nan)
        parts.append((part, _range(values[:, :, column])))
        part.curves, part.states, part.times = {}, [], []
    return NodeSummary(f'{flight.name}  {flight.seconds:.0f} s', parts)


def _range(values: Array) -> Array:
    """Least, median and greatest."""
    known = np.isfinite(values[0])
    if not known.any():
        return np.full(3, np.nan)
    mean, least, greatest = values[:, known]
    return np.array([least.min(), np.median(mean), greatest.max()])


def overview(flights: Sequence[NodeSummary]) -> Figure:
    """All flights on one page: a line for each."""
    kinds = [
        kind
        for kind in (False, True)
        if any(p.is_runway is kind for f in flights for p, _ in f.parts)
    ]
    columns = [column for kind in kinds for column in ((kind, 'share'), (kind, 'range'))]
    figure = Figure(
        figsize=(3.0 + 4.0 * len(columns), 1.8 + 0.3 * len(flights)), layout='constrained'
    )
    axes = figure.subplots(1, len(columns), sharey=True, squeeze=False)[0]
    for axis, (is_runway, what) in zip(axes, columns, strict=True):
        for row, flight in enumerate(flights):
            for part, extent in flight.parts:
                if part.is_runway is not is_runway:
                    continue
                if what == 'share':
                    _draw_shares(axis, row, part)
                else:
                    axis.plot(extent[[0, 2]], [row, row], color=_COLORS[0], linewidth=2)
                    axis.plot(extent[1], row, 'o', color=_COLORS[0], markersize=5)
        axis.grid(axis='x', alpha=0.3)
        if what == 'share':
            axis.set_xlim(0, 100)
            axis.set_xlabel('frames with a pose [%]' if is_runway else 'markers and poses [%]')
            if is_runway:
                axis.set_title('runway', fontsize='medium')
            else:
                posed = Patch(color=_COLORS[2], label='frames with a pose')
                _add_legend(axis, [*_states_key(), posed], (0.0, 1.0), columns=2)
        else:
            words = 'height [m]' if is_runway else 'roll [°]'
            axis.set_xlabel(f'{words}: least, median, greatest')
    axes[0].set_yticks(range(len(flights)), [flight.name for flight in flights], fontsize='small')
    axes[0].set_ylim(len(flights) - 0.5, -0.5)
    return figure


def _draw_shares(axis: Axes, row: int, part: NodePart) -> None:
    """Markers by state above, frames with a pose below."""
    left, total = 0.0, sum(part.counts)
    for count, color in zip(part.counts, _STATE_COLORS, strict=True):
        if total:
            width = 100.0 * count / total
            axis.barh(row - 0.15, width, 0.4, left, color=color)
            left += width
    axis.barh(row + 0.2, 100.0 * part.poses / max(part.frames, 1), 0.2, color=_COLORS[2])


def _save(figure: Figure, path: Path) -> None:
    png = BytesIO()
    figure.savefig(png, dpi=110, format='png')
    write_whole(path, png.getvalue())

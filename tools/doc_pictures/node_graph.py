"""Nodes and topics, from what the processors declare."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch

from doc_pictures.style import BLUE, GRAY, GREEN, INK, ORANGE, save
from mvuav_ros.processing.processor import Processor
from mvuav_ros.processing.registry import PROCESSORS

_LINE = 0.36


def node_graph(path: Path) -> None:
    """The source at the left, the detectors in the middle, what they publish at the right."""
    figure, axis = plt.subplots(figsize=(11, 5.4))
    axis.set(xlim=(0, 22), ylim=(4.4, 14.9))
    axis.axis('off')
    _box(axis, 0.2, 9.0, 4.2, 2.0, 'video_source', 'or a camera driver', BLUE)
    axis.text(
        0.3, 8.5, 'image_raw\ncamera_info', fontsize=9, color=BLUE, va='top', family='monospace'
    )
    _box(axis, 0.2, 5.4, 4.2, 1.3, 'autopilot or IMU', '', GRAY)
    _box(axis, 0.2, 12.6, 4.2, 1.9, 'tuning_panel', 'shows and tunes all', GRAY)
    top = 14.6
    for name, processor in PROCESSORS.items():
        topics = _outputs(processor)
        height = _LINE * len(topics) + 0.6
        middle = top - height / 2
        _box(axis, 9.2, middle - 1.1, 4.2, 2.2, name, '', GREEN)
        for number, (topic, kind) in enumerate(topics):
            y = top - 0.45 - _LINE * number
            color = ORANGE if kind == 'Image' else INK
            axis.text(15.3, y, topic, fontsize=9, color=color, va='center', family='monospace')
            axis.text(19.6, y, kind, fontsize=8, color=GRAY, va='center')
        axis.plot([15.1, 15.1], [top - 0.2, top - height + 0.2], color=GREEN, lw=1.5)
        _arrow(axis, (13.5, middle), (15.0, middle), GREEN)
        _arrow(axis, (4.5, 10.0), (9.1, middle), BLUE)
        if processor.uses_attitude:
            _arrow(axis, (4.5, 6.1), (9.1, middle - 0.6), GRAY)
            axis.text(6.9, 6.7, 'imu', fontsize=9, color=GRAY, va='center', family='monospace')
        top -= height + 0.5
    axis.text(
        9.2,
        4.6,
        'Orange: images, computed only while somebody subscribes.',
        fontsize=8,
        color=ORANGE,
    )
    axis.text(0.2, 4.6, '~ is the name of the node. All nodes publish /diagnostics.', fontsize=8)
    save(figure, path)


def _outputs(processor: type[Processor]) -> list[tuple[str, str]]:
    topics = {**processor.topics, **processor.periodic_topics}
    rows = [(f'~/{name}', kind.__name__) for name, kind in topics.items() if '/' not in name]
    if any(name.startswith('marker/') for name in topics):
        rows.append(('~/marker/<name>', 'PointStamped'))
    rows.append(('/tf', 'TFMessage'))
    return rows + [(f'~/{name}', 'Image') for name in processor.debug_topics]


def _box(
    axis: Axes, x: float, y: float, width: float, height: float, name: str, below: str, color: str
) -> None:
    patch = FancyBboxPatch(
        (x, y),
        width,
        height,
        boxstyle='round,pad=0.02,rounding_size=0.25',
        facecolor='white',
        edgecolor=color,
        linewidth=2,
    )
    axis.add_patch(patch)
    lift = 0.35 if below else 0.0
    axis.text(
        x + width / 2,
        y + height / 2 + lift,
        name,
        ha='center',
        va='center',
        color=color,
        fontsize=11,
    )
    if below:
        axis.text(x + width / 2, y + height / 2 - 0.45, below, ha='center', va='center', fontsize=9)


def _arrow(axis: Axes, start: tuple[float, float], end: tuple[float, float], color: str) -> None:
    arrow = {'arrowstyle': '-|>', 'color': color, 'lw': 1.6}
    axis.annotate('', xy=end, xytext=start, arrowprops=arrow)

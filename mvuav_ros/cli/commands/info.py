"""``mvuav info``: what is inside a recording."""

from __future__ import annotations

from array import array
from collections import Counter
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from mvuav_ros.cli.terminal import frame_progress, say, table_console
from mvuav_ros.messages.frame import BadFrame
from mvuav_ros.messages.untrusted import visible
from mvuav_ros.recordings.remote import is_url, local_copy
from mvuav_ros.recordings.summary import RecordingSummary, TopicSummary, summarise
from mvuav_ros.sources.opening import looks_like_bag, open_source
from mvuav_ros.sources.source import FrameSource

_MOST_ROWS = 200


@dataclass
class FrameSummary:
    """What a video file or a folder of images holds.

    ``duration_s`` is from the first to the last stamp, ``rate_hz`` the median interval's inverse.
    """

    path: str
    frames: int = 0
    rate_hz: float | None = None
    duration_s: float = 0.0
    formats: list[str] = field(default_factory=list)
    unusable: int = 0
    errors: list[str] = field(default_factory=list)


def info(
    source: Annotated[
        str,
        typer.Argument(metavar='INPUT', help='A bag, a video file, or a folder or glob of images.'),
    ],
) -> RecordingSummary | FrameSummary:
    """Say what is inside INPUT: topics, types, counts, rates, sizes, encodings and damage."""
    summary: RecordingSummary | FrameSummary
    with local_copy(source) as path:
        if path.exists() and looks_like_bag(path):
            with frame_progress() as bar:
                task = bar.add_task(visible(path.name), total=None)
                summary = summarise(
                    path, lambda done, total: bar.update(task, completed=done, total=total)
                )
        else:
            name = str(path) if is_url(source) else source
            summary = _summarise_images(source, open_source(name, cameras=False))
    summary.path = source
    if isinstance(summary, RecordingSummary):
        _print_recording(summary)
    else:
        _print_images(summary)
    return summary


def _summarise_images(text: str, frames: FrameSource) -> FrameSummary:
    summary = FrameSummary(text, rate_hz=frames.rate)
    formats: Counter[str] = Counter()
    stamps = array('q')
    for frame in frames.frames():
        summary.frames += 1
        stamps.append(frame.stamp_ns)
        if isinstance(frame, BadFrame):
            summary.unusable += 1
            continue
        image = frame.image
        formats[f'{image.width}x{image.height} {image.encoding}'] += 1
    summary.formats = [name for name, _ in formats.most_common()]
    if len(stamps) > 1:
        summary.duration_s = (stamps[-1] - stamps[0]) / 1e9
        summary.rate_hz = 1e9 / float(np.median(np.diff(stamps)))
    if summary.unusable:
        said = f'{summary.unusable} frames do not decode'
        frames.account.lose('', 'frames', said, summary.unusable)
    summary.errors = frames.account.errors
    return summary


def _print_recording(summary: RecordingSummary) -> None:
    say(f'{summary.path}: {summary.messages} messages in {summary.duration_s:.2f} s')
    table = Table(box=None, pad_edge=False)
    for heading in ('topic', 'type', 'count', 'Hz', 'images', 'warnings'):
        table.add_column(heading, overflow='fold')
    for topic in summary.topics[:_MOST_ROWS]:
        images = ', '.join(topic.images.formats) if topic.images else ''
        rate = f'{topic.rate_hz:.2f}' if topic.rate_hz else '-'
        cells = topic.name, topic.type, str(topic.count), rate, images, _notes(topic)
        table.add_row(*map(visible, cells))
    table_console(240).print(table)
    if len(summary.topics) > _MOST_ROWS:
        say(f'and {len(summary.topics) - _MOST_ROWS} more topics, which --json lists')
    for skipped in summary.skipped[:_MOST_ROWS]:
        say(f'skipped: {skipped.name} is {skipped.encoding or "without encoding"}, not CDR')


def _notes(topic: TopicSummary) -> str:
    warnings = []
    if topic.gaps:
        warnings.append(f'{topic.gaps} gaps, longest {topic.longest_gap_s:.2f} s')
    if topic.jumps_back:
        warnings.append(f'time jumps back {topic.jumps_back} times')
    if topic.images and topic.images.header_jumps_back:
        warnings.append(f'stamps jump back {topic.images.header_jumps_back} times')
    if topic.images and topic.images.malformed:
        warnings.append(f'{topic.images.malformed} malformed: {topic.images.first_problem}')
    return '; '.join(warnings)


def _print_images(summary: FrameSummary) -> None:
    rate = f'{summary.rate_hz:.2f} Hz' if summary.rate_hz else 'no rate'
    say(
        f'{summary.path}: {summary.frames} frames, {rate}, {summary.duration_s:.2f} s, '
        f'{", ".join(summary.formats) or "nothing that decodes"}'
    )

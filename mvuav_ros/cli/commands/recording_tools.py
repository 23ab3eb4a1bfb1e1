"""``mvuav info``, ``repair`` and ``export``: what is in a recording, saved, and as tables."""

from __future__ import annotations

from array import array
from collections import Counter
from contextlib import ExitStack
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from mvuav_ros.cli.options import Force, Format, SplitMb, Storage, refuse_to_overwrite
from mvuav_ros.cli.terminal import frame_progress, print_table, say
from mvuav_ros.messages.untrusted import visible
from mvuav_ros.recordings.account import counted
from mvuav_ros.recordings.remote import inside, is_url, local_copy, local_output

if TYPE_CHECKING:
    from mvuav_ros.recordings.summary import RecordingSummary, TopicSummary
    from mvuav_ros.sources.source import FrameSource

_MAX_ROWS = 200


def info(
    source: str = typer.Argument(
        ..., metavar='INPUT', help='A bag, a video file, or a folder or glob of images.'
    ),
) -> object:
    """Say what is inside INPUT: topics, types, counts, rates, sizes, encodings and damage."""
    from mvuav_ros.recordings.summary import summarise
    from mvuav_ros.sources.opening import looks_like_bag, open_source

    with local_copy(source) as path:
        if not (path.exists() and looks_like_bag(path)):
            name = str(path) if is_url(source) else source
            return _summarise_images(source, open_source(name, cameras=False))
        with frame_progress() as bar:
            task = bar.add_task(visible(path.name), total=None)
            summary = summarise(
                path, lambda done, total: bar.update(task, completed=done, total=total)
            )
    summary.path = source
    _print_recording(summary)
    return summary


def _summarise_images(text: str, frames: FrameSource) -> dict[str, Any]:
    """Say what a video file or a folder of images holds.

    ``duration_s`` is from the first to the last stamp, ``rate_hz`` the median interval's inverse.
    """
    import numpy as np

    from mvuav_ros.messages.images import BadFrame
    from mvuav_ros.sources.files import ImageFolder

    formats: Counter[str] = Counter()
    stamps, rate, duration, unusable = array('q'), frames.rate, 0.0, 0
    for frame in frames.frames():
        stamps.append(frame.stamp_ns)
        if isinstance(frame, BadFrame):
            unusable += 1
            continue
        image = frame.image
        formats[f'{image.width}x{image.height} {image.encoding}'] += 1
    if len(stamps) > 1:
        duration = (stamps[-1] - stamps[0]) / 1e9
        rate = 1e9 / float(np.median(np.diff(stamps)))
    if unusable:
        frames.account.lose('', 'frames', f'{counted(unusable, "frame")} not decoded', unusable)
    names = [name for name, _ in formats.most_common()]
    known, words = f'{rate:.2f} Hz' if rate else 'no rate', ', '.join(names)
    if isinstance(frames, ImageFolder):
        known += ' (assumed, as there are no stamps)'
    said = f'{known}, {duration:.2f} s, {words or "nothing that decodes"}'
    say(f'{text}: {counted(len(stamps), "frame")}, {said}')
    return {
        'path': text,
        'frames': len(stamps),
        'rate_hz': rate,
        'duration_s': duration,
        'formats': names,
        'unusable': unusable,
        'errors': frames.account.errors,
    }


def _print_recording(summary: RecordingSummary) -> None:
    say(f'{summary.path}: {counted(summary.messages, "message")} in {summary.duration_s:.2f} s')
    rows = []
    for topic in summary.topics[:_MAX_ROWS]:
        images = ', '.join(topic.images.formats) if topic.images else ''
        rate = f'{topic.rate_hz:.2f}' if topic.rate_hz else '-'
        rows.append((topic.name, topic.type, str(topic.count), rate, images, _notes(topic)))
    print_table(('topic', 'type', 'count', 'Hz', 'images', 'warnings'), rows, 240)
    if len(summary.topics) > _MAX_ROWS:
        say(f'and {len(summary.topics) - _MAX_ROWS} more topics, which --json lists')
    for skipped in summary.skipped[:_MAX_ROWS]:
        say(f'skipped: {skipped.name} is {skipped.encoding or "without encoding"}, not CDR')


def _notes(topic: TopicSummary) -> str:
    warnings = []
    if topic.gaps:
        warnings.append(f'{counted(topic.gaps, "gap")}, longest {topic.longest_gap_s:.2f} s')
    if topic.jumps_back:
        warnings.append(f'time jumps back {counted(topic.jumps_back, "time")}')
    if topic.images and topic.images.header_jumps_back:
        warnings.append(f'stamps jump back {counted(topic.images.header_jumps_back, "time")}')
    if topic.images and topic.images.header_repeats:
        repeats = counted(topic.images.header_repeats, 'image')
        warnings.append(f'{repeats} with the stamp of the one before')
    if topic.images and topic.images.malformed:
        warnings.append(f'{topic.images.malformed} malformed: {topic.images.first_problem}')
    return '; '.join(warnings)


def repair(
    source: str = typer.Argument(..., metavar='INPUT', help='A bag in any condition.'),
    output: str = typer.Option(..., '--output', '-o', help='OUT.mcap, or a new folder; or a URL.'),
    storage: Format = Storage.MCAP,
    split_mb: SplitMb = 0,
    force: Force = False,
) -> dict[str, Any]:
    """Copy every readable message of all topics to a new file, and list what was lost."""
    from mvuav_ros.recordings.repairing import repair as write

    refuse_to_overwrite(output, force)
    with local_copy(source) as path, local_output(output) as target, frame_progress() as bar:
        task = bar.add_task(visible(path.name), total=None)
        messages = write(
            path,
            target,
            overwrite=force,
            split_bytes=storage.split_bytes(split_mb),
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    say(f'{output}: {counted(messages.total(), "message")}')
    for topic, count in list(messages.items())[:_MAX_ROWS]:
        say(f'  {topic}: {count}')
    if len(messages) > _MAX_ROWS:
        say(f'  and {len(messages) - _MAX_ROWS} more topics')
    return {'output': output, 'messages': messages}


Form = StrEnum('Form', ['csv', 'parquet', 'tum', 'mot'])


def export(
    sources: list[str] = typer.Argument(
        ..., metavar='RESULTS...', help='Bags of results, or folders of them.'
    ),
    output: str = typer.Option(..., '--output', '-o', help='The folder for the files, or its URL.'),
    form: Form = typer.Option(
        Form.csv,
        '--format',
        help='Format of the files; tum: poses for evo, mot: markers for TrackEval.',
    ),
    plot: bool = typer.Option(
        False, '--plot', help='Also draw a page for each flight, and an overview.'
    ),
    force: Force = False,
) -> dict[str, Any]:
    """Write markers, roll, poses and lines of all flights, one file for each topic."""
    from mvuav_ros.recordings.layout import by_flight, recordings_in
    from mvuav_ros.recordings.tables import export as write
    from mvuav_ros.sources.opening import looks_like_bag

    found = [each for source in sources for each in recordings_in(source)]
    # Beside bags of results there may be the pictures of an earlier export or of a report.
    bags = [each for each in found if each in sources or looks_like_bag(Path(each).expanduser())]
    named = by_flight(bags or found)
    refuse_to_overwrite(output, force)
    with local_output(output) as folder, ExitStack() as copies:
        flights = {name: copies.enter_context(local_copy(each)) for name, each in named.items()}
        files = write(flights, folder, form.value, overwrite=force)
        pictures = []
        if plot:
            from mvuav_ros.offline.plots import plot as draw

            pictures = draw(flights, folder / 'plots', overwrite=force)
    rows = {str(file.relative_to(folder)): count for file, count in files.items()}
    for name, count in rows.items():
        say(f'{inside(output, name)}: {counted(count, "row")}')
    for picture in pictures:
        say(inside(output, f'plots/{picture.name}'))
    return {'files': rows, 'pictures': [f'plots/{picture.name}' for picture in pictures]}

"""Which file each recording's results go to."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from mvuav_ros.offline.replay.job import ReplayJob, ReplaySettings
from mvuav_ros.recordings.layout import by_flight, recordings_in
from mvuav_ros.recordings.recording import RecordingError
from mvuav_ros.recordings.remote import inside, is_url
from mvuav_ros.sources.opening import PREFIX


class Plan(NamedTuple):
    """A job for each recording; ``folder`` is that of a batch's outputs, None for a single one."""

    jobs: list[ReplayJob]
    folder: str | None


def plan(
    sources: Sequence[str],
    output: str,
    settings: ReplaySettings,
    *,
    overwrite: bool = False,
    absolute: bool = False,
) -> Plan:
    """Say where the results of each recording go.

    Args:
        sources: what the user names; of a folder of recordings each is a recording by itself.
        output: a path or URL: a name that ends in .mcap or, needed for several recordings, a
            folder. A single recording's results as a rosbag2 folder are that folder.
        settings: what is done with each of them.
        overwrite: whether outputs that exist are replaced.
        absolute: whether the paths are to hold in other processes.

    Raises:
        RecordingError: the output does not fit, or two recordings have the same name.
        OSError: the folder cannot be made.
    """
    if absolute:
        output = output if is_url(output) else str(Path(output).absolute())
        sources = [_absolute(source) for source in sources]
    sources = [each for source in sources for each in recordings_in(source)]
    is_folder = settings.split_bytes is not None
    if len(sources) == 1 and (is_folder or output.endswith('.mcap')):
        return Plan([ReplayJob(sources[0], output, settings, overwrite)], None)
    if not output.endswith('/') and Path(output).suffix and not Path(output).is_dir():
        raise RecordingError(
            f'{output}: the name of a recording must end in .mcap'
            if len(sources) == 1
            else f'{output}: several inputs need a folder as output ({len(sources)} recordings)'
        )
    ending = '' if is_folder else '.mcap'
    targets = {inside(output, name + ending): each for name, each in by_flight(sources).items()}
    if not is_url(output):
        Path(output).mkdir(parents=True, exist_ok=True)
    jobs = [ReplayJob(source, target, settings, overwrite) for target, source in targets.items()]
    return Plan(jobs, output)


def _absolute(source: str) -> str:
    if source.startswith(PREFIX) or is_url(source):
        return source
    return str(Path(source).expanduser().absolute())

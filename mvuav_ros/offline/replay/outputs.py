"""Which file each recording's results go to."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mvuav_ros.offline.replay.job import ReplayJob, ReplaySettings
from mvuav_ros.recordings.errors import RecordingError
from mvuav_ros.recordings.remote import is_url
from mvuav_ros.recordings.sources.simulated import PREFIX

_SUFFIXES = ('.zstd', '.zst', '.mcap', '.db3', '.bag')


def plan(
    sources: Sequence[str],
    output: Path,
    settings: ReplaySettings,
    *,
    overwrite: bool = False,
    absolute: bool = False,
) -> list[ReplayJob]:
    """One job for each recording.

    Args:
        sources: what the user names.
        output: a file's name that ends in .mcap or, needed for several, a folder.
        settings: what is done with each of them.
        overwrite: whether outputs that exist are replaced.
        absolute: whether the paths are to hold in other processes.

    Raises:
        RecordingError: the output does not fit, or two recordings have the same name.
        OSError: the folder cannot be made.
    """
    if output.parts[:1] and output.parts[0].endswith(':'):  # what a Path makes of an URL
        raise RecordingError(f'{output}: outputs are written to files of this machine, not to URLs')
    if len(sources) == 1 and output.suffix == '.mcap':
        return [_job(sources[0], output, settings, overwrite, False, absolute)]
    if output.suffix and not output.is_dir():
        raise RecordingError(
            f'{output}: the name of a recording must end in .mcap'
            if len(sources) == 1
            else f'{output}: several inputs need a folder as output'
        )
    targets: dict[Path, str] = {}
    for source in sources:
        target = output / f'{_name(source)}.mcap'
        if target in targets:
            raise RecordingError(
                f'{targets[target]} and {source} would both become {target}; '
                'replay them into folders of their own'
            )
        targets[target] = source
    output.mkdir(parents=True, exist_ok=True)
    return [
        _job(source, target, settings, overwrite, True, absolute)
        for target, source in targets.items()
    ]


def _job(
    source: str,
    output: Path,
    settings: ReplaySettings,
    overwrite: bool,
    resume: bool,
    absolute: bool,
) -> ReplayJob:
    if absolute:
        output = output.absolute()
        if not source.startswith(PREFIX) and not is_url(source):
            source = str(Path(source).expanduser().absolute())
    return ReplayJob(source, output, settings, overwrite, resume)


def _name(source: str) -> str:
    path = Path(source).expanduser()
    if path.name == 'metadata.yaml':
        path = path.parent
    name = path.absolute().name
    if any(sign in name for sign in '*?['):
        name = path.absolute().parent.name
    if path.is_dir():
        return name
    for suffix in _SUFFIXES:
        name = name.removesuffix(suffix)
    return name if path.suffix in _SUFFIXES else name.removesuffix(path.suffix)

"""One recording through the nodes into one file: what is done, where to, and from what."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from glob import glob
from pathlib import Path
from typing import Any, NamedTuple

import mvuav_ros
from mvuav_ros.offline.replay.frame_replay import (
    FrameResults,
    ReplayInput,
    make_processors,
    replay,
    replay_in_threads,
)
from mvuav_ros.offline.stopping import Stop
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.recordings.account import Account, RecordingError
from mvuav_ros.recordings.layout import by_flight, recordings_in
from mvuav_ros.recordings.recording import RecordedMessage
from mvuav_ros.recordings.remote import inside, is_url, local_output, remote_state, size_at
from mvuav_ros.recordings.rosbag2_folder import Rosbag2Writer, open_writer
from mvuav_ros.recordings.writing import RecordingWriter
from mvuav_ros.sources.opening import PREFIX, looks_like_bag
from mvuav_ros.sources.source import EVERYTHING, Selection, SourceError, gamma_corrected
from mvuav_ros.vision.camera import CameraModel

DESCRIPTION = 'mvuav_replay'
"""The metadata record at the beginning of a replayed file."""


def description(source: str, settings: ReplaySettings) -> dict[str, str]:
    """What distinguishes results of the same input, version and parameters from others.

    Raises:
        RecordingError: the input cannot be reached.
        OSError: likewise.
    """
    return {
        'version': mvuav_ros.__version__,
        **fingerprint(source),
        'settings': json.dumps(dataclasses.asdict(settings), sort_keys=True),
    }


def fingerprint(source: str) -> dict[str, str]:
    """The input's path, and a digest of the names, sizes and times of its files."""
    if is_url(source):
        size, mark = remote_state(source)
        return {'input': source, 'input_bytes': str(size), 'input_files': mark}
    path = Path(source).expanduser()
    digest = hashlib.sha256()
    total = 0
    for file in _files(path):
        status = file.stat()
        total += status.st_size
        name = os.fsencode(file.name)
        digest.update(b'%s\0%d\0%d\n' % (name, status.st_size, status.st_mtime_ns))
    return {
        'input': os.fsencode(path.resolve()).decode('utf-8', 'replace'),
        'input_bytes': str(total),
        'input_files': digest.hexdigest(),
    }


def _files(path: Path) -> Iterator[Path]:
    if path.is_file():
        yield path
    elif path.is_dir():
        yield from sorted(entry for entry in path.iterdir() if entry.is_file())
    else:
        yield from sorted(file for file in map(Path, glob(str(path))) if file.is_file())  # noqa: PTH207


PROGRESS_INTERVAL = 0.1
"""Seconds between two reports."""


@dataclass(frozen=True)
class ReplaySettings:
    """What is done with every recording.

    Attributes:
        parameters: of each node to run, by its name.
        image_topic: of bags that have several.
        fps: frame rate of images without stamps, Hz.
        selection: the part of the recording.
        keep_inputs: whether the input's messages go along.
        debug_images: whether debug images are made.
        gamma: eq. 3.2 on every image before the nodes see it, as ``video_source`` has it; 1: off.
        camera: the calibration of all images; None: what comes with them.
        split_bytes: None for one mcap file; else a rosbag2 folder, and the size at which its next
            part begins (0: never).
    """

    parameters: Mapping[str, Mapping[str, Any]]
    image_topic: str | None = None
    fps: float | None = None
    selection: Selection = EVERYTHING
    keep_inputs: bool = False
    debug_images: bool = False
    gamma: float = 1.0
    camera: CameraModel | None = None
    split_bytes: int | None = None


@dataclass(frozen=True)
class ReplayJob:
    """One recording, and where its results go: paths or URLs."""

    source: str
    output: str
    settings: ReplaySettings
    overwrite: bool = False


@dataclass
class ReplayOutcome:
    """What became of a job.

    Attributes:
        source: the recording.
        output: what was written.
        frames: read, unusable ones included.
        processed: by every node.
        rejected: number of frames without a result, by reason.
        errors: what of the recording could not be read, in words.
        warnings: what is unusual without a loss.
        account: of the recording; None if it was not read.
        done_before: the output was finished before.
        interrupted: the end was asked for; the file is complete up to there.
        failure: why it came to nothing, in words; empty otherwise.
    """

    source: str
    output: str
    frames: int = 0
    processed: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    errors: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    account: Account | None = None
    done_before: bool = False
    interrupted: bool = False
    failure: str = ''

    @property
    def lossy(self) -> bool:
        """Whether anything was lost or rejected."""
        return bool(self.rejected or self.errors)

    def record(self) -> dict[str, Any]:
        """All of it but the account, as JSON knows it."""
        return {name: value for name, value in vars(self).items() if name != 'account'}

    def count(self, results: FrameResults) -> None:
        """Take in a frame; very many different reasons are counted as one."""
        self.frames += 1
        self.processed += not results.reasons
        for reason in results.reasons:
            full = reason not in self.rejected and len(self.rejected) >= _MAX_REASONS
            self.rejected['other reasons' if full else reason] += 1


_MAX_REASONS = 100


class JobProgress(NamedTuple):
    """The input's name, the frames done, and how many there are as far as known."""

    name: str
    done: int
    total: int | None


Writer = RecordingWriter | Rosbag2Writer
Progress = Callable[[JobProgress], None]


def run_job(
    job: ReplayJob, outcome: ReplayOutcome, progress: Progress, stop: Stop, threads: int = 1
) -> None:
    """Replay a recording; interrupted, the output is complete up to there.

    The outcome is kept up to date and holds also after an error. With one thread all of the work
    is done in this one.

    Raises:
        SourceError: the input cannot be read, or none of its frames be used.
        RecordingError: the output cannot be written.
        ParameterError: a parameter is not valid.
    """
    if is_own_input(job):
        raise RecordingError(f'{job.output} is (in) the input itself; give another output')
    if not job.overwrite and size_at(job.output) is not None:
        raise RecordingError(f'{job.output} exists; --force overwrites it')
    settings = job.settings
    processors = make_processors(settings.parameters)
    with _opened(job, stop) as source:
        if source is None:
            outcome.interrupted = True
            return
        progress(JobProgress(source.name, 0, source.count))
        with _writing(job) as writer:
            items = source.items(
                keep=settings.keep_inputs,
                camera=any(processor.uses_camera_info for processor in processors),
                attitude=any(processor.awaits_attitude for processor in processors),
            )
            with closing(gamma_corrected(items, settings.gamma)) as items:
                output = _Output(job, writer, outcome, source.account)
                if threads == 1:
                    steps = replay(items, processors, debug=settings.debug_images)
                else:
                    steps = replay_in_threads(
                        items, processors, threads - 1, debug=settings.debug_images
                    )
                with closing(steps):
                    _write(steps, output, source, progress, stop)
            if not outcome.interrupted and outcome.processed == 0:
                what = 'could be used' if outcome.frames else 'is there'
                raise SourceError(f'{job.source}: not a single frame {what}')


def attempt(job: ReplayJob, progress: Progress, stop: Stop, threads: int = 1) -> ReplayOutcome:
    """`run_job`, with what goes wrong said in the outcome."""
    outcome = ReplayOutcome(job.source, job.output)
    try:
        run_job(job, outcome, progress, stop, threads)
    except (SourceError, RecordingError, ParameterError, OSError) as error:
        outcome.failure = ' '.join(str(error).split())
    except Exception as error:
        # A defect of ours costs one recording and not all the others.
        outcome.failure = ' '.join(f'{job.source}: {type(error).__name__}: {error}'.split())
    return outcome


@contextmanager
def _writing(job: ReplayJob) -> Iterator[Writer]:
    metadata = {DESCRIPTION: description(job.source, job.settings)}
    with (
        local_output(job.output) as path,
        open_writer(path, job.settings.split_bytes, job.overwrite, metadata) as writer,
    ):
        yield writer


@contextmanager
def _opened(job: ReplayJob, stop: Stop) -> Iterator[ReplayInput | None]:
    """The job's input, None where the end was asked for first."""
    given = job.settings
    source = stop.unless_requested(
        lambda: ReplayInput(job.source, given.image_topic, given.fps, given.selection, given.camera)
    )
    try:
        yield source
    finally:
        if source is not None:
            source.close()


def _write(
    steps: Iterator[FrameResults | RecordedMessage],
    output: _Output,
    source: ReplayInput,
    progress: Progress,
    stop: Stop,
) -> None:
    """Write what the nodes say, until the input or the user's patience ends."""
    outcome = output.outcome
    reported = time.monotonic()
    try:
        for step in steps:
            output.take(step)
            if stop:
                outcome.interrupted = True
                break
            if time.monotonic() >= reported + PROGRESS_INTERVAL:
                progress(JobProgress(source.name, outcome.frames, source.count))
                reported = time.monotonic()
    finally:
        outcome.account = source.account
        outcome.errors, outcome.warnings = source.account.errors, source.account.warnings
        outcome.errors += [source.account.balance] if outcome.errors else []
    progress(JobProgress(source.name, outcome.frames, outcome.frames))


class _Output:
    """Writes results, and copies of the input's messages except onto the results' own topics."""

    def __init__(
        self, job: ReplayJob, writer: Writer, outcome: ReplayOutcome, account: Account
    ) -> None:
        self.outcome = outcome
        self._account = account
        self._results = tuple(f'/{name}/' for name in job.settings.parameters)
        self._writer = writer

    def take(self, step: FrameResults | RecordedMessage) -> None:
        if isinstance(step, FrameResults):
            for topic, kind, data in step.messages:
                self._writer.write(topic, kind, step.stamp_ns, data)
            if step.is_frame:
                self.outcome.count(step)
        elif step.topic.startswith(self._results):
            said = f'{step.topic} of the input is not copied, because the replay writes it'
            self._account.note(('left out', step.topic), said)
        else:
            self._writer.write(*step)


def is_own_input(job: ReplayJob) -> bool:
    """Whether the output is the input, or a file among those of the input."""
    source, output = Path(job.source).expanduser(), Path(job.output)
    if is_url(job.output):
        return job.source == job.output
    if source.exists() and output.resolve() == source.resolve():
        return True
    if source.is_dir() and looks_like_bag(source) and output.resolve().parent == source.resolve():
        return True
    return source.is_file() and output.exists() and output.samefile(source)


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

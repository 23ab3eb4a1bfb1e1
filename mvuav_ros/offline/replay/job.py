"""One recording through the nodes' code into one file; can be sent to another process."""

from __future__ import annotations

import dataclasses
import json
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import mvuav_ros
from mvuav_ros.offline.processes import ProcessDiedError
from mvuav_ros.offline.replay.ahead import ReplayAhead
from mvuav_ros.offline.replay.frames import FrameResults, make_processors, replay
from mvuav_ros.offline.replay.inputs import Item, ReplayInput
from mvuav_ros.offline.replay.records import DESCRIPTION, RESULT, State, fingerprint, state_of
from mvuav_ros.offline.stopping import Stop
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.processing.processor import Processor
from mvuav_ros.recordings.errors import RecordingError
from mvuav_ros.recordings.recording import RecordedMessage
from mvuav_ros.recordings.sources.frame import SourceError
from mvuav_ros.recordings.sources.gamma import gamma_corrected
from mvuav_ros.recordings.sources.opening import looks_like_bag
from mvuav_ros.recordings.sources.selection import EVERYTHING, Selection
from mvuav_ros.recordings.writing import RecordingWriter

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
    """

    parameters: Mapping[str, Mapping[str, Any]]
    image_topic: str | None = None
    fps: float | None = None
    selection: Selection = EVERYTHING
    keep_inputs: bool = False
    debug_images: bool = False
    gamma: float = 1.0


@dataclass(frozen=True)
class ReplayJob:
    """One recording, and where its results go.

    ``resume`` says that a finished output is left as it is, and an unfinished one done again.
    """

    source: str
    output: Path
    settings: ReplaySettings
    overwrite: bool = False
    resume: bool = False


@dataclass
class ReplayOutcome:
    """What became of a job.

    Attributes:
        source: the recording.
        output: the file written.
        frames: read, unusable ones included.
        processed: by every node.
        rejected: number of frames without a result, by reason.
        errors: what of the recording could not be read, in words.
        warnings: what is unusual without a loss.
        done_before: the output was finished before.
        interrupted: the end was asked for; the file is complete up to there.
        failure: why it came to nothing, in words; empty otherwise.
    """

    source: str
    output: Path
    frames: int = 0
    processed: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    errors: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    done_before: bool = False
    interrupted: bool = False
    failure: str = ''

    @property
    def lossy(self) -> bool:
        """Whether anything was lost or rejected."""
        return bool(self.rejected or self.errors)

    def counts(self) -> dict[str, Any]:
        """What is kept of it in files."""
        names = ('frames', 'processed', 'rejected', 'errors', 'warnings')
        return {name: getattr(self, name) for name in names}

    def count(self, results: FrameResults) -> None:
        """Take in a frame; very many different reasons are counted as one."""
        self.frames += 1
        self.processed += not results.reasons
        for reason in results.reasons:
            full = reason not in self.rejected and len(self.rejected) >= _MOST_REASONS
            self.rejected['other reasons' if full else reason] += 1


_MOST_REASONS = 100


class JobProgress(NamedTuple):
    """The input's name, the frames done, and how many there are as far as known."""

    name: str
    done: int
    total: int | None


Progress = Callable[[JobProgress], None]
Replaying = Callable[[Iterable[Item]], Iterator[FrameResults | RecordedMessage]]


def run_job(
    job: ReplayJob, outcome: ReplayOutcome, progress: Progress, stop: Stop, processes: int = 1
) -> None:
    """Replay a recording.

    Interrupted, the output is a complete file, though not a finished one in the sense of
    `state_of`.

    Args:
        job: what to replay, and where to.
        outcome: kept up to date; it holds also after an error.
        progress: told now and then how far it is.
        stop: when to end early.
        processes: that share the work; with 1 all of it is done in this one.

    Raises:
        SourceError: the input cannot be read, or none of its frames be used.
        RecordingError: the output cannot be written.
        ParameterError: a parameter is not valid.
    """
    _refuse_own_input(job)
    description = _description(job)
    state, result = state_of(job.output, description)
    if job.resume and state is State.FINISHED and not job.overwrite:
        outcome.done_before = True
        vars(outcome).update(result)
        return
    redo = job.overwrite or (job.resume and state is State.UNFINISHED)
    if state is not State.ABSENT and not redo:
        other = ', but was not made from this input by this version with these parameters'
        raise RecordingError(
            f'{job.output} exists{other if job.resume else ""}; --force overwrites it'
        )
    settings = job.settings
    processors = make_processors(settings.parameters)
    # The processes first: they are forked, which is right only before the input has threads.
    with _replaying(processors, settings, processes) as replaying, _opened(job, stop) as source:
        if source is None:
            outcome.interrupted = True
            return
        progress(JobProgress(source.name, 0, source.count))
        with RecordingWriter(job.output, redo, {DESCRIPTION: description}) as writer:
            items = source.items(
                keep=settings.keep_inputs,
                camera=any(processor.uses_camera_info for processor in processors),
                attitude=any(processor.awaits_attitude for processor in processors),
            )
            with closing(gamma_corrected(items, settings.gamma)) as items:
                output = _Output(job, writer, outcome)
                _write(replaying(items), output, source, progress, stop)
            if not outcome.interrupted:
                if outcome.processed == 0:
                    raise SourceError(f'{job.source}: not a single frame could be used')
                writer.conclude(RESULT, {'json': json.dumps(outcome.counts())})


def attempt(job: ReplayJob, progress: Progress, stop: Stop, processes: int = 1) -> ReplayOutcome:
    """`run_job`, with what goes wrong told in the outcome."""
    outcome = ReplayOutcome(job.source, job.output)
    try:
        run_job(job, outcome, progress, stop, processes)
    except (SourceError, RecordingError, ParameterError, ProcessDiedError, OSError) as error:
        outcome.failure = ' '.join(str(error).split())
    except Exception as error:
        # A defect of ours costs one recording and not all the others.
        outcome.failure = ' '.join(f'{job.source}: {type(error).__name__}: {error}'.split())
    return outcome


@contextmanager
def _replaying(
    processors: list[Processor], settings: ReplaySettings, processes: int
) -> Iterator[Replaying]:
    if processes == 1:
        yield partial(replay, processors=processors, debug=settings.debug_images)
        return
    with closing(ReplayAhead(processors, processes, debug=settings.debug_images)) as ahead:
        yield ahead.replay


@contextmanager
def _opened(job: ReplayJob, stop: Stop) -> Iterator[ReplayInput | None]:
    """The job's input, None where the end was asked for first."""
    given = job.settings
    source = stop.unless_requested(
        lambda: ReplayInput(job.source, given.image_topic, given.fps, given.selection)
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
        outcome.errors = list(source.errors)
        outcome.warnings = [*source.warnings, *output.warnings]
    progress(JobProgress(source.name, outcome.frames, outcome.frames))


class _Output:
    """Writes results, and copies of the input's messages except onto the results' own topics."""

    def __init__(self, job: ReplayJob, writer: RecordingWriter, outcome: ReplayOutcome) -> None:
        self.outcome = outcome
        self._results = tuple(f'/{name}/' for name in job.settings.parameters)
        self._writer = writer
        self._left_out: dict[str, None] = {}

    @property
    def warnings(self) -> list[str]:
        return [
            f'{topic} of the input is not copied: it is written anew' for topic in self._left_out
        ]

    def take(self, step: FrameResults | RecordedMessage) -> None:
        if isinstance(step, FrameResults):
            for topic, kind, data in step.messages:
                self._writer.write(topic, kind, step.stamp_ns, data)
            if step.is_frame:
                self.outcome.count(step)
        elif step.topic.startswith(self._results):
            self._left_out[step.topic] = None
        else:
            self._writer.copy(step)


def _description(job: ReplayJob) -> dict[str, str]:
    settings = dataclasses.asdict(job.settings)
    return {
        'version': mvuav_ros.__version__,
        **fingerprint(job.source),
        'settings': json.dumps(settings, sort_keys=True),
    }


def _refuse_own_input(job: ReplayJob) -> None:
    source = Path(job.source).expanduser()
    output = job.output.resolve()
    own = source.exists() and output == source.resolve()
    if source.is_dir() and looks_like_bag(source):
        own = own or output.parent == source.resolve()
    if own or (source.is_file() and output.exists() and output.samefile(source)):
        raise RecordingError(f'{job.output} is (in) the input itself; give another output')

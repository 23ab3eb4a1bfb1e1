"""One recording through the nodes' code into one file; can be sent to another process."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import mvuav_ros
from mvuav_ros.offline.replay.frames import ReplayCounts
from mvuav_ros.offline.replay.frames import replay as process
from mvuav_ros.offline.replay.inputs import Input, Item, open_input
from mvuav_ros.offline.replay.interruptions import held_back
from mvuav_ros.offline.replay.prefetching import prefetched
from mvuav_ros.offline.replay.records import DESCRIPTION, RESULT, State, fingerprint, state_of
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.processing.processor import Processor
from mvuav_ros.processing.registry import PROCESSORS
from mvuav_ros.recordings.errors import RecordingError
from mvuav_ros.recordings.recording import RecordedMessage
from mvuav_ros.recordings.sources.frame import BadFrame, Frame, SourceError
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
    """

    parameters: Mapping[str, Mapping[str, Any]]
    image_topic: str | None = None
    fps: float | None = None
    selection: Selection = EVERYTHING
    keep_inputs: bool = False
    debug_images: bool = False


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
        answered: processed by every node.
        refused: number of frames without a result, by reason.
        losses: what of the recording could not be read, in words.
        remarks: what is unusual without a loss.
        done_before: the output was finished before.
        error: why it failed, in words; empty otherwise.
    """

    source: str
    output: Path
    frames: int = 0
    answered: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    losses: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    done_before: bool = False
    error: str = ''

    @property
    def lossy(self) -> bool:
        """Whether anything was lost or refused."""
        return bool(self.refused or self.losses)


_RESULT_FIELDS = ('frames', 'answered', 'refused', 'losses', 'remarks')


class JobProgress(NamedTuple):
    """The input's name, the frames done, and how many there are as far as known."""

    name: str
    done: int
    total: int | None


Progress = Callable[[JobProgress], None]


def make_processors(parameters: Mapping[str, Mapping[str, Any]]) -> list[Processor]:
    """The nodes with their parameters.

    Raises:
        ParameterError: a parameter is unknown, or its value not valid.
    """
    processors = []
    for name, values in parameters.items():
        processor = PROCESSORS[name]()
        processor.configure(processor.parameters_type.from_mapping(values))
        processors.append(processor)
    return processors


def run_job(
    job: ReplayJob, outcome: ReplayOutcome, progress: Progress, *, ahead: bool = True
) -> None:
    """Replay a recording.

    Interrupted by the user (KeyboardInterrupt, SystemExit), the output is a complete file, though
    not a finished one in the sense of `state_of`.

    Args:
        job: what to replay, and where to.
        outcome: kept up to date; it holds also after an error.
        progress: told now and then how far it is.
        ahead: whether a thread reads ahead; without a core to spare it would cost and gain nothing.

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
        raise RecordingError(_exists(job))
    settings = job.settings
    processors = make_processors(settings.parameters)
    source = open_input(job.source, settings.image_topic, settings.fps, settings.selection)
    with closing(source):
        progress(JobProgress(source.name, 0, source.count))
        writer = RecordingWriter(job.output, redo, {DESCRIPTION: description})
        with _closed_at_the_end(writer):
            items = source.items(
                settings.keep_inputs,
                any(p.uses_camera_info for p in processors),
                any(p.awaits_attitude for p in processors),
            )
            copier = _Copier(processors, writer)
            try:
                with closing(prefetched(items) if ahead else items) as items:
                    frames = copier.frames(items)
                    counts = process(frames, processors, writer.write, debug=settings.debug_images)
                    _follow(counts, outcome, source, progress)
            finally:
                outcome.losses = list(source.losses)
                outcome.remarks = [*source.remarks, *copier.remarks]
            if outcome.answered == 0:
                raise SourceError(f'{job.source}: not a single frame could be used')
            result = {name: getattr(outcome, name) for name in _RESULT_FIELDS}
            writer.conclude(RESULT, {'json': json.dumps(result)})


def attempt(
    job: ReplayJob, outcome: ReplayOutcome, progress: Progress, *, ahead: bool = True
) -> None:
    """`run_job`, with what goes wrong told in the outcome."""
    try:
        run_job(job, outcome, progress, ahead=ahead)
    except (SourceError, RecordingError, ParameterError, OSError) as error:
        outcome.error = ' '.join(str(error).split())
    except Exception as error:
        # A defect of ours costs one recording and not all the others.
        outcome.error = ' '.join(f'{job.source}: {type(error).__name__}: {error}'.split())


def _follow(
    all_counts: Iterable[ReplayCounts], outcome: ReplayOutcome, source: Input, progress: Progress
) -> None:
    reported = time.monotonic()
    for counts in all_counts:
        outcome.frames, outcome.answered = counts.frames, counts.answered
        outcome.refused = counts.refused
        if time.monotonic() >= reported + PROGRESS_INTERVAL:
            progress(JobProgress(source.name, counts.frames, source.count))
            reported = time.monotonic()
    progress(JobProgress(source.name, outcome.frames, outcome.frames))


class _Copier:
    """Copies the input's messages on their way past, except onto the results' own topics."""

    def __init__(self, processors: list[Processor], writer: RecordingWriter) -> None:
        self._results = tuple(f'/{processor.name}/' for processor in processors)
        self._writer = writer
        self._left_out: dict[str, None] = {}

    @property
    def remarks(self) -> list[str]:
        return [
            f'{topic} of the input is not copied: it is written anew' for topic in self._left_out
        ]

    def frames(self, items: Iterable[Item]) -> Iterator[Frame | BadFrame]:
        for item in items:
            if not isinstance(item, RecordedMessage):
                yield item
            elif item.topic.startswith(self._results):
                self._left_out[item.topic] = None
            else:
                self._writer.copy(item)


@contextmanager
def _closed_at_the_end(writer: RecordingWriter) -> Iterator[None]:
    """As the writer's own context, but a second Ctrl-C does not interrupt the closing."""
    try:
        yield
    except BaseException as error:
        with held_back():
            writer.__exit__(type(error), error, error.__traceback__)
        raise
    with held_back():
        writer.close()


def _description(job: ReplayJob) -> dict[str, str]:
    settings = dataclasses.asdict(job.settings)
    return {
        'version': mvuav_ros.__version__,
        **fingerprint(job.source),
        'settings': json.dumps(settings, sort_keys=True),
    }


def _exists(job: ReplayJob) -> str:
    if job.resume:
        return (
            f'{job.output} exists, but was not made from this input by this version with these '
            'parameters; --force overwrites it'
        )
    return f'{job.output} exists; --force overwrites it'


def _refuse_own_input(job: ReplayJob) -> None:
    source = Path(job.source).expanduser()
    output = job.output.resolve()
    own = source.exists() and output == source.resolve()
    if source.is_dir() and looks_like_bag(source):
        own = own or output.parent == source.resolve()
    if own or (source.is_file() and output.exists() and output.samefile(source)):
        raise RecordingError(f'{job.output} is (in) the input itself; give another output')

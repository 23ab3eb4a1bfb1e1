"""One recording through the nodes into one file, frame after frame, without a ROS graph."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import time
from collections import Counter
from collections.abc import Callable, Collection, Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import mvuav_ros
from mvuav_ros.messages.cdr import CdrReader, cdr_header
from mvuav_ros.messages.images import BadFrame, Frame
from mvuav_ros.messages.sensors import CAMERA_INFO, encode_camera_info, topic_beside
from mvuav_ros.offline.frame_messages import frame_messages
from mvuav_ros.offline.replay.pipeline import FrameResults, Item, make_processors, replay
from mvuav_ros.offline.stopping import Stop
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.parameters.parameter_file import NODE_PARAMETERS
from mvuav_ros.processing.processor import Processor
from mvuav_ros.recordings.account import Account, RecordingError, counted
from mvuav_ros.recordings.layout import SIMULATED, absolute_place, fingerprint
from mvuav_ros.recordings.remote import is_url, local_output, size_at
from mvuav_ros.recordings.rosbag2_folder import open_writer
from mvuav_ros.recordings.stored_file import RecordedMessage
from mvuav_ros.recordings.writing import RELIABLE_QOS, RecordingWriter
from mvuav_ros.sources.bag import BagImages
from mvuav_ros.sources.files import ImageFolder
from mvuav_ros.sources.opening import looks_like_bag, open_source
from mvuav_ros.sources.source import EVERYTHING, Selection, SourceError
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import ImageError

DESCRIPTION = 'mvuav_replay'
"""The metadata record at the beginning of a replayed file."""


def description(source: str, settings: ReplaySettings) -> dict[str, str]:
    """What distinguishes results of the same input, version and parameters from others.

    Files that parameters name, such as the rig's, count by their content.

    Raises:
        RecordingError: the input cannot be reached.
        OSError: likewise.
    """
    files = [Path(place) for _, _, place in settings.files()]
    content = b''.join(file.read_bytes() for file in files if file.is_file())
    return {
        'version': mvuav_ros.__version__,
        **({'input': source} if source.startswith(SIMULATED) else fingerprint(source)),
        'settings': json.dumps(dataclasses.asdict(settings), sort_keys=True),
        **({'parameter_files': hashlib.sha256(content).hexdigest()} if content else {}),
    }


PROGRESS_INTERVAL = 0.1
"""Seconds between two reports."""


@dataclass(frozen=True)
class ReplaySettings:
    """What is done with every recording.

    ``split_bytes`` is None for one mcap file; else a rosbag2 folder is written, and that is the
    size at which its next part begins (0: never).
    """

    parameters: Mapping[str, Mapping[str, Any]]  # of each node to run, by its name
    image_topic: str | None = None  # of bags that have several
    imu_topic: str | None = None  # of bags that have it neither beside the images nor at /imu
    camera_info_topic: str | None = None  # of bags that do not have it beside the images
    fps: float | None = None  # frame rate of images without stamps, Hz
    selection: Selection = EVERYTHING  # the part of the recording
    keep_inputs: bool = False  # whether the input's messages go along
    debug_images: bool = False  # whether they are made
    gamma: float = 1.0  # eq. 3.2 on every image before the nodes see it; 1: off
    camera: CameraModel | None = None  # the calibration of all images; None: what comes with them
    split_bytes: int | None = None

    def files(self) -> Iterator[tuple[str, str, str]]:
        """The files that parameters name: node, parameter, absolute path."""
        for node, given in self.parameters.items():
            for spec in NODE_PARAMETERS[node].specs():
                if spec.is_file and (place := given.get(spec.name)):
                    yield node, spec.name, absolute_place(str(place))

    def absolute(self) -> ReplaySettings:
        """The same for a process in another folder."""
        parameters = {node: dict(given) for node, given in self.parameters.items()}
        for node, name, place in self.files():
            parameters[node][name] = place
        return replace(self, parameters=parameters)

    def described(self) -> dict[str, str]:
        """What is not at its default, for reports: by node, and by what else there is to say."""
        nodes = {node: str(given or 'defaults') for node, given in self.parameters.items()}
        others = {each.name: getattr(self, each.name) for each in fields(self)[1:]}
        usual = vars(ReplaySettings({}))
        return nodes | {name: str(own) for name, own in others.items() if own != usual[name]}


@dataclass(frozen=True)
class ReplayJob:
    """One recording, and where its results go: paths or URLs."""

    source: str
    output: str
    settings: ReplaySettings
    overwrite: bool = False


@dataclass
class ReplayOutcome:
    """What became of a job."""

    source: str
    output: str
    frames: int = 0  # read, unusable ones included
    processed: int = 0  # by every node
    rejected: Counter[str] = field(default_factory=Counter)  # frames without a result, by reason
    errors: list[str] = field(default_factory=list)  # what could not be read, in words
    warnings: list[str] = field(default_factory=list)  # what is unusual without a loss
    account: Account | None = None  # of the recording; None if it was not read
    done_before: bool = False
    interrupted: bool = False  # the end was asked for; the file is complete up to there
    failure: str = ''  # why it came to nothing, in words
    # What each node has said of every frame, by its name; the parts as keys, in their order.
    always: dict[str, dict[str, None]] = field(default_factory=dict)

    def record(self) -> dict[str, Any]:
        """All of it but what its account says, as JSON knows it."""
        return {n: value for n, value in vars(self).items() if n not in ('account', 'always')}

    def count(self, results: FrameResults) -> None:
        """Take in a frame; very many different reasons are counted as one."""
        self.frames += 1
        self.processed += not results.reasons
        for reason in results.reasons:
            full = reason not in self.rejected and len(self.rejected) >= _MAX_REASONS
            self.rejected['other reasons' if full else reason] += 1
        for node, status in results.statuses.items():
            parts = dict.fromkeys(filter(None, status.split('; ')))
            known = self.always.setdefault(node, parts)
            self.always[node] = {part: None for part in known if part in parts}

    def note_statuses(self, account: Account) -> None:
        """Say what each node has said of every frame: a mistake in the settings, as a rule."""
        for node, parts in self.always.items():
            if parts:
                account.note(('status', node), f'{node}, every frame: {"; ".join(parts)}')


_MAX_REASONS = 100


class JobProgress(NamedTuple):
    """The input's name, the frames done, and how many there are as far as known."""

    name: str
    done: int
    total: int | None


class ReplayInput:
    """A bag, a video, or images, or the part of it that a selection names."""

    def __init__(self, text: str, given: ReplaySettings) -> None:
        """Open it.

        Raises:
            SourceError: there is no such thing, nothing in it can be read, or the calibration is
                not one of its images.
        """
        source = open_source(
            text,
            topic=given.image_topic,
            imu_topic=given.imu_topic,
            camera_info_topic=given.camera_info_topic,
            rate=given.fps,
            cameras=False,
        )
        self._source, self._selection, self._camera = source, given.selection, given.camera
        self.name, self.account, self.close = source.name, source.account, source.close
        if self._camera is not None:
            if source.is_rectified:
                self._camera = self._camera.rectified()
            first = next((each for each in source.frames() if isinstance(each, Frame)), None)
            image = None if first is None else first.image
            if image is not None and (said := self._camera.objection(image.width, image.height)):
                self.close()
                raise SourceError(f'{self.name}: {said}')
        if isinstance(source, ImageFolder) and given.fps is None:
            self.account.note('fps', f'no stamps: {source.rate:g} images/s are assumed (--fps)')
        source.start_s = given.selection.start_s

    @property
    def count(self) -> int | None:
        """Number of frames as far as it is known."""
        if isinstance(self._source, BagImages):
            return self._source.count
        return self._selection.count(self._source.count, self._source.rate)

    def items(
        self, processors: Sequence[Processor], keep: Collection[str] | None = ()
    ) -> Generator[Item, None, None]:
        """Frames for these nodes, and the messages of topics to ``keep``; None: of all.

        Those of a bag have their calibrations and the body's attitude, if a node uses them. A
        calibration that was given is copied in place of those.
        """
        source, given = self._source, self._camera
        if not isinstance(source, BagImages):
            yield from self._images(keep)
            return
        camera = given is None and any(processor.uses_camera_info for processor in processors)
        attitude = any(processor.awaits_attitude for processor in processors)
        if camera:
            self._hint('calibration', 'camera-info', source.camera_topic, source.camera_topics)
        if attitude:
            self._hint('attitude', 'imu', source.imu_topic, source.imu_topics)
        beside = topic_beside(source.topic, 'camera_info')
        for item in source.items(self._selection, others=keep, camera=camera, attitude=attitude):
            if given is None or isinstance(item, BadFrame):
                yield item
            elif not isinstance(item, RecordedMessage):
                yield replace(item, camera=given)
            elif item.topic != beside:
                if item.topic == source.topic:
                    with suppress(ImageError):  # one that is damaged has no header
                        info = encode_camera_info(given, cdr_header(*CdrReader(item.data).header()))
                        content = item.stamp_ns, info, None, RELIABLE_QOS
                        yield RecordedMessage(beside, CAMERA_INFO, *content)
                yield item

    def _hint(self, what: str, option: str, used: str | None, there: Sequence[str]) -> None:
        """Name the topics that could be used, where none is."""
        if used is None and there:
            said = f'no {what} is used; --{option}-topic names its topic: {", ".join(there)}'
            self.account.note(option, said)

    def _images(self, keep: Collection[str] | None) -> Iterator[Item]:
        """Those of no bag, which have no messages: a frame's are made of it."""
        for index, frame in enumerate(self._selection.stretch(self._source)):
            if isinstance(frame, Frame):
                if self._camera is not None:
                    frame = replace(frame, camera=self._camera)
                for topic, kind, make in frame_messages(frame):
                    if keep is None or topic in keep:
                        qos = RELIABLE_QOS
                        yield RecordedMessage(topic, kind, frame.stamp_ns, make(), None, qos)
            if index % self._selection.every == 0:
                yield frame


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
    refuse_own_input(job)
    if not job.overwrite and size_at(job.output) is not None:
        raise RecordingError(f'{job.output} exists; --force overwrites it')
    settings = job.settings
    processors = make_processors(settings.parameters)
    source = stop.unless_requested(lambda: ReplayInput(job.source, settings))
    if source is None:
        outcome.interrupted = True
        return
    items = source.items(processors, keep=None if settings.keep_inputs else ())
    steps = replay(
        items, processors, threads=threads, debug=settings.debug_images, gamma=settings.gamma
    )
    with closing(source), ExitStack() as outputs, closing(items), closing(steps):
        output = _Output(job, outputs, outcome, source.account)
        progress(JobProgress(source.name, 0, source.count))
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
            else:
                outcome.note_statuses(source.account)
                if resets := max((each.resets for each in processors), default=0):
                    back = counted(resets, 'time')
                    said = f'the stamps jump back {back}, after which all begins afresh'
                    source.account.note('stamps', said)
        finally:
            outcome.account = source.account
            outcome.errors, outcome.warnings = source.account.errors, source.account.warnings
            outcome.errors += [source.account.balance] if outcome.errors else []
        progress(JobProgress(source.name, outcome.frames, outcome.frames))
        if not outcome.interrupted and outcome.processed == 0:
            what = 'could be used' if outcome.frames else 'is there'
            raise SourceError(f'{job.source}: not a single frame {what}')


def attempt(job: ReplayJob, progress: Progress, stop: Stop, threads: int = 1) -> ReplayOutcome:
    """`run_job`, with what goes wrong said in the outcome."""
    outcome = ReplayOutcome(job.source, job.output)
    try:
        run_job(job, outcome, progress, stop, threads)
    except (SourceError, ParameterError, OSError) as error:
        outcome.failure = ' '.join(str(error).split())
    except Exception as error:
        # A defect of ours costs one recording and not all the others.
        outcome.failure = ' '.join(f'{job.source}: {type(error).__name__}: {error}'.split())
    return outcome


class _Output:
    """Writes results, and copies of the input's messages except onto the results' own topics.

    What is there already is replaced by the first message, as there may be none. A result's number
    is that of its frame, from 1, as frames that cannot be used have none. Beside copies
    results are logged at their time: stamps may be of another clock, decades away.
    """

    def __init__(
        self, job: ReplayJob, outputs: ExitStack, outcome: ReplayOutcome, account: Account
    ) -> None:
        self.outcome = outcome
        self._account = account
        self._results = tuple(f'/{name}/' for name in job.settings.parameters)
        self._job, self._outputs = job, outputs
        self._logged_ns: int | None = None

    def take(self, step: FrameResults | RecordedMessage) -> None:
        if isinstance(step, FrameResults):
            logged_ns = step.stamp_ns if self._logged_ns is None else self._logged_ns
            number = self.outcome.frames + step.is_frame
            for topic, kind, data in step.messages:
                self._writer.write(topic, kind, logged_ns, data, sequence=number)
            if step.is_frame:
                self.outcome.count(step)
            return
        self._logged_ns = step.stamp_ns
        if step.topic.startswith(self._results):
            said = f'{step.topic} of the input is not copied, because the replay writes it'
            self._account.note(('left out', step.topic), said)
        else:
            self._writer.write(*step)

    @cached_property
    def _writer(self) -> RecordingWriter:
        job = self._job
        metadata = {DESCRIPTION: description(job.source, job.settings)}
        path = self._outputs.enter_context(local_output(job.output))
        writer = open_writer(path, job.settings.split_bytes, job.overwrite, metadata)
        self._outputs.enter_context(writer)
        return writer


def refuse_own_input(job: ReplayJob) -> None:
    """RecordingError where the output is the input, or a file among those of the input."""
    if is_own_input(job):
        raise RecordingError(f'{job.output} is (in) the input itself; give another output')


def is_own_input(job: ReplayJob) -> bool:
    """Whether the output is the input, a file among those of the input, or a folder around it."""
    if is_url(job.output):
        return job.source == job.output
    source, output = Path(job.source).expanduser(), Path(job.output)
    own, target = source.resolve(), output.resolve()
    if source.exists() and target in (own, *own.parents):
        return True
    if source.is_dir() and looks_like_bag(source) and target.parent == own:
        return True
    return source.is_file() and output.exists() and output.samefile(source)

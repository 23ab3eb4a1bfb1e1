"""What the nodes said of each frame, and what was true of it: from a bag or a replay."""

from __future__ import annotations

from collections import Counter
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.messages.cdr import view_points
from mvuav_ros.messages.definitions import decode_message
from mvuav_ros.messages.sensors import stamp_ns_of
from mvuav_ros.messages.untrusted import MalformedMessageError, words
from mvuav_ros.offline.replay import pipeline
from mvuav_ros.offline.replay.job import ReplayInput, ReplayOutcome, ReplaySettings
from mvuav_ros.processing.registry import PROCESSORS
from mvuav_ros.recordings.account import Account, counted
from mvuav_ros.recordings.layout import SIMULATED
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.result_rows import marker_names
from mvuav_ros.recordings.stored_file import RecordedMessage
from mvuav_ros.sources.opening import looks_like_bag
from mvuav_ros.sources.source import SourceError

MARKERS, RPY, LINES, POSE, TRUE_POSE = 'markers', 'rpy', 'lines', 'pose', 'true pose'
TRUTH_TOPICS = {f'/truth/{kind}': kind for kind in (MARKERS, RPY, LINES)}
TRUTH_TOPICS['/truth/pose'] = TRUE_POSE
_TYPES = {
    MARKERS: 'sensor_msgs/msg/PointCloud2',
    RPY: 'geometry_msgs/msg/Vector3Stamped',
    LINES: 'sensor_msgs/msg/PointCloud2',
    POSE: 'geometry_msgs/msg/PoseWithCovarianceStamped',
    TRUE_POSE: 'geometry_msgs/msg/PoseStamped',
}
RESULT_TOPICS = {f'/marker_tracker/{kind}': kind for kind in (MARKERS, RPY, POSE)}
RESULT_TOPICS['/runway_detector/line_params'] = LINES
_FIELDS = {
    MARKERS: {'x', 'y', 'label', 'state'},
    LINES: {'x', 'y', 'x2', 'y2', 'rho', 'theta', 'flags'},
}
Rows = NDArray[np.void]


@dataclass
class Observations:
    """By stamp (ns): marker rows, roll (rad), line rows, poses.

    A pose is its frame's name, and x, y, z (m) and the quaternion's x, y, z, w, (7,).
    """

    markers: dict[int, Rows] = field(default_factory=dict)
    rpy: dict[int, float] = field(default_factory=dict)
    lines: dict[int, Rows] = field(default_factory=dict)
    poses: dict[int, tuple[str, NDArray[np.float64]]] = field(default_factory=dict)

    def add(self, kind: str, data: bytes | memoryview) -> None:
        """Take in a message's CDR.

        Raises:
            MalformedMessageError: it is none of that kind.
        """
        message = decode_message(_TYPES[kind], data)
        stamp_ns = stamp_ns_of(message.header)
        if kind == RPY:
            self.rpy[stamp_ns] = float(message.vector.x)
            return
        if kind in (POSE, TRUE_POSE):
            pose = message.pose.pose if kind == POSE else message.pose
            p, q = pose.position, pose.orientation
            numbers = np.array((p.x, p.y, p.z, q.x, q.y, q.z, q.w))
            self.poses[stamp_ns] = message.header.frame_id, numbers
            return
        rows = view_points(message)
        if missing := _FIELDS[kind] - {*(rows.dtype.names or ())}:
            raise MalformedMessageError(f'it has no {", ".join(sorted(missing))}')
        getattr(self, kind)[stamp_ns] = rows

    @property
    def stamps(self) -> set[int]:
        """Of all frames."""
        return {*self.markers, *self.rpy, *self.lines, *self.poses}


@dataclass
class EvaluationRun:
    """One input's results and truth."""

    name: str
    results: Observations = field(default_factory=Observations)
    truth: Observations = field(default_factory=Observations)  # empty where the input has none
    names: dict[int, str] = field(default_factory=dict)  # of the markers by label, where known
    frames: int = 0  # replayed, or with results in the bag
    rejected: int | None = None  # without a result; None for results read from a bag
    milliseconds: float = float('nan')  # of all nodes for a frame, median; NaN without a replay
    errors: list[str] = field(default_factory=list)  # what could not be read, in words
    unreadable: Counter[str] = field(default_factory=Counter)  # messages, by topic
    _reasons: dict[str, str] = field(default_factory=dict)  # of each such topic's first one

    @property
    def mismatch(self) -> str:
        """Why nothing of it can be compared, if it has truth and results; else empty."""
        theirs, ours = self.truth.stamps, self.results.stamps
        apart = theirs and ours and not theirs & ours
        return 'no result has the stamp of any truth, by which they are matched' if apart else ''

    def take(self, topic: str, data: bytes | memoryview) -> None:
        """Take in a message; it is left where it is neither a result nor truth."""
        try:
            if topic in TRUTH_TOPICS:
                self.truth.add(TRUTH_TOPICS[topic], data)
            elif topic in RESULT_TOPICS:
                self.results.add(RESULT_TOPICS[topic], data)
        except (AttributeError, KeyError, ValueError, OverflowError) as error:
            self.unreadable[topic] += 1
            self._reasons.setdefault(topic, words(error))

    def end(self, account: Account) -> None:
        """After the last message: say what could not be read."""
        for topic, count in self.unreadable.items():
            said = f'{counted(count, "message")} of {topic} not used: {self._reasons[topic]}'
            account.lose('', topic, said, count)
        self.errors += account.errors


def read_bag(path: Path) -> EvaluationRun:
    """The truth and the nodes' results that a bag holds.

    Raises:
        RecordingError: nothing can be read from there.
    """
    run = EvaluationRun(str(path))
    with open_recording(path) as recording:
        for label, name in marker_names(recording, '/marker_tracker').items():
            # A dollar sign would begin a formula in a figure.
            run.names[label] = words(name).replace('$', '')
        for message in recording.messages({*TRUTH_TOPICS, *RESULT_TOPICS}):
            run.take(message.topic, message.data)
        run.end(recording.account)
    run.frames = len(run.results.stamps)
    return run


def replay(text: str, settings: ReplaySettings) -> EvaluationRun:
    """Run nodes over an input as `run_job` does; its truth comes from it as well.

    Raises:
        SourceError: the input cannot be read, or none of its frames be used.
        RecordingError: the bag cannot be read.
        ParameterError: a parameter is not valid.
    """
    processors = pipeline.make_processors(settings.parameters)
    trackers = (each for each in processors if each.name == 'marker_tracker')
    markers = (topic for each in trackers for topic in each.topics if topic.startswith('marker/'))
    names = dict(enumerate(topic.removeprefix('marker/') for topic in markers))
    run = EvaluationRun(text, names=names)
    outcome, seconds = ReplayOutcome(text, ''), list[float]()
    with closing(ReplayInput(text, settings)) as source:
        items = source.items(processors, keep=TRUTH_TOPICS)
        for step in pipeline.replay(items, processors, gamma=settings.gamma):
            if isinstance(step, RecordedMessage):
                run.take(step.topic, step.data)
            elif step.is_frame:
                outcome.count(step)
                seconds += [step.seconds] if step.seconds else []
                for name, _, data in step.messages:
                    run.take(name, data)
        outcome.note_statuses(source.account)
        run.end(source.account)
    run.frames, run.rejected = outcome.frames, outcome.frames - outcome.processed
    if not outcome.processed:
        raise SourceError(f'{text}: not a single frame could be used')
    said = outcome.rejected.items()
    run.errors += [f'{n} frames: {why}' for why, n in said if why.startswith(pipeline.DEFECT)]
    run.errors += [run.mismatch] if run.mismatch else []
    run.milliseconds = float(np.median(seconds)) * 1e3
    return run


def nodes_for(text: str) -> list[str]:
    """The nodes whose results an input's truth can judge; all where nothing says.

    Raises:
        RecordingError: a bag cannot be read.
    """
    if text.startswith(SIMULATED):
        tanker = text.removeprefix(SIMULATED).startswith('tanker')
        return ['marker_tracker'] if tanker else ['runway_detector']
    path = Path(text).expanduser()
    if not (path.exists() and looks_like_bag(path)):
        return list(PROCESSORS)
    with open_recording(path) as recording:
        kinds = {TRUTH_TOPICS[t.name] for t in recording.topics if t.name in TRUTH_TOPICS}
    nodes = ['marker_tracker'] if kinds & {MARKERS, RPY} else []
    nodes += ['runway_detector'] if LINES in kinds else []
    return nodes or list(PROCESSORS)

"""What nodes publish on ``/diagnostics``: counts, times, and sentences that name a remedy."""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from statistics import median
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from mvuav_ros.messages.images import Frame, StampReader
from mvuav_ros.nodes.image_input import InputEvents, InputState
from mvuav_ros.nodes.running import PROFILE
from mvuav_ros.parameters.common_parameters import TRANSPORTS
from mvuav_ros.processing.processor import Processor
from mvuav_ros.recordings.account import counted
from mvuav_ros.vision.image import Image

WINDOW = 5.0
"""Seconds over which rates, latencies and recent troubles are taken."""
_LONGEST_REASON = 300


class FrameTimes(NamedTuple):
    """Where the time of one processed frame went, s."""

    transport: float  # from the publisher to us; NaN if the middleware does not say
    decode: float  # bytes to image
    process: float  # image to messages
    publish: float  # messages to the middleware
    total: float  # from taking the bytes to the last message, waiting included


T = TypeVar('T')


class _Recent(Generic[T]):
    """What was noted in the last seconds."""

    def __init__(self) -> None:
        self._noted: deque[tuple[float, T]] = deque()

    def note(self, what: T) -> None:
        self._noted.append((time.monotonic(), what))

    def all(self) -> list[T]:
        oldest = time.monotonic() - WINDOW
        while self._noted and self._noted[0][0] < oldest:
            self._noted.popleft()
        # Another thread may note something meanwhile.
        return [what for _, what in list(self._noted)]


class FrameStatistics:
    """What came in, what went out, how long it took and what was rejected, and why."""

    def __init__(self) -> None:
        self.enabled = True  # Else images are counted, and not answered
        self.received = self.processed = 0
        self.rejected: Counter[str] = Counter()
        self.last_reason = self.image_format = ''
        self.restart()

    def restart(self) -> None:
        """Images are expected from now on; counts go on."""
        self.stamps = StampMonitor()
        self._arrivals, self._rejections = _Recent[None](), _Recent[None]()
        self._results = _Recent[FrameTimes]()
        self._quiet_since = time.monotonic()

    def arrived(self) -> None:
        """Count a frame."""
        self.received += 1
        self._quiet_since = time.monotonic()
        self._arrivals.note(None)

    def processed_one(self, frame: Frame, times: FrameTimes) -> None:
        """Count the results of a frame."""
        self.processed += 1
        self._results.note(times)
        self.image_format = _format(frame.image)
        self.stamps.follow(frame.stamp_ns)

    def reject(self, kind: str, reason: str) -> None:
        """Count a frame that got no result, by kind (``bad image``), and keep the reason."""
        self.rejected[kind] += 1
        self._rejections.note(None)
        self.last_reason = reason[:_LONGEST_REASON]
        self.stamps.interrupt()

    def problems(self) -> list[str]:
        """What was wrong with the frames of the last seconds, in words."""
        rejected, arrived = len(self._rejections.all()), len(self._arrivals.all())
        return [f'{rejected} of {arrived} images rejected: {self.last_reason}'] if rejected else []

    @property
    def silent(self) -> bool:
        """Whether no frame came within the last seconds."""
        return not self._arrivals.all()

    @property
    def quiet_for(self) -> float:
        """Seconds since the last frame, or since frames are expected."""
        return time.monotonic() - self._quiet_since

    def values(self) -> dict[str, str]:
        """Key-values of a diagnostic status."""
        times = self._results.all()
        return {
            'input_rate_hz': f'{len(self._arrivals.all()) / WINDOW:.1f}',
            'output_rate_hz': f'{len(times) / WINDOW:.1f}',
            **_percentiles_ms(times),
            'frames_received': str(self.received),
            'frames_processed': str(self.processed),
            'frames_rejected': str(self.rejected.total()),
            **{f'rejected_{kind.replace(" ", "_")}': str(n) for kind, n in self.rejected.items()},
            'last_rejection': self.last_reason,
        }


def _format(image: Image) -> str:
    return f'{image.width}x{image.height} {image.encoding}'


def _percentiles_ms(times: Sequence[FrameTimes]) -> dict[str, str]:
    rows = np.array(times or [FrameTimes(*[math.nan] * 5)]) * 1e3
    (*stages, p50), (*_, p95), (*_, p99) = np.percentile(rows, (50, 95, 99), axis=0).tolist()
    values = {'latency_p50': p50, 'latency_p95': p95, 'latency_p99': p99}
    for stage, value in zip(FrameTimes._fields[:-1], stages, strict=True):
        values[f'{stage}_p50'] = value
    return {f'{name}_ms': f'{value:.2f}' for name, value in values.items()}


_SEGMENT = 1 << 19
"""Bytes of Fast DDS's own shared-memory segment."""
_OTHER_REMEDY = (
    'let it publish reliably and set qos_overrides.….subscription.reliability to reliable '
    '(docs/transport.md)'
)
_SEGMENT_REMEDY = f'start it with FASTRTPS_DEFAULT_PROFILES_FILE={PROFILE}, or {_OTHER_REMEDY}'
SLOW_REMEDY = 'lower the frame rate or the image size'
_MAX_NAMED = 3
_STAMPS = 32
_GAP = 1.6
"""Times the usual spacing of stamps, from which on a frame is missing in between."""


class StampMonitor:
    """Follows the stamps of images: their spacing, and gaps in it."""

    def __init__(self) -> None:
        self._spacings: deque[int] = deque(maxlen=_STAMPS)
        self._last_ns: int | None = None
        self.frames_left_out = 0
        self.jumps_forward = 0

    def follow(self, stamp_ns: int) -> None:
        """Take the next frame's stamp."""
        last, self._last_ns = self._last_ns, stamp_ns
        if last is None or stamp_ns <= last:
            return
        spacing = stamp_ns - last
        usual = self.spacing_ns
        if usual and spacing > WINDOW * 1e9:
            # A pause of the recording or another clock: no frames are missing there.
            self.jumps_forward += 1
            return
        if usual and spacing > _GAP * usual:
            self.frames_left_out += round(spacing / usual) - 1
        self._spacings.append(spacing)

    def interrupt(self) -> None:
        """A frame, or some, are not followed: they are missing for another reason."""
        self._last_ns = None

    @property
    def spacing_ns(self) -> int:
        """The usual time between two stamps; 0 while too few have come."""
        return round(median(self._spacings)) if len(self._spacings) >= 8 else 0


class DetectorStatus:
    """Turns counts into a detector's diagnostic status, once a second while it is active."""

    def __init__(self, statistics: FrameStatistics, processor: Processor) -> None:
        self._statistics, self._processor = statistics, processor
        self._history: deque[dict[str, int]] = deque(maxlen=round(WINDOW) + 1)
        self.lost = 0  # images in transport, in the seconds of the newest report

    @property
    def state(self) -> str:
        """``running`` or ``disabled``."""
        return 'running' if self._statistics.enabled else 'disabled'

    def report(self, name: str, images: InputState, notes: Sequence[str]) -> DiagnosticStatus:
        """The status of the last seconds, while nothing else touches the statistics.

        ``notes`` are said beside it, and are no reason for a warning.
        """
        statistics, level = self._statistics, DiagnosticStatus.OK
        problems = self._input_problems(images)
        if statistics.enabled and statistics.silent:
            never = statistics.received == 0
            level = DiagnosticStatus.STALE if never else DiagnosticStatus.WARN
            since = '' if never else f' for {WINDOW:.0f} s'
            problems = [f'no images{since}: {explain_no_images(images, self.lost)}']
        elif statistics.enabled:
            problems += statistics.problems()
            problems += filter(None, (self._processor.status, self._processor.frames_problem))
        if problems and level == DiagnosticStatus.OK:
            level = DiagnosticStatus.WARN
        words = '; '.join([*(problems or [self.state]), *notes])
        return status(level, name, words, self._values(images))

    def _input_problems(self, images: InputState) -> list[str]:
        """What became of images in the last seconds, and the remedy."""
        events = images.events
        counts = {name: n for name, n in vars(events).items() if isinstance(n, int)}
        counts['left_out'] = self._statistics.stamps.frames_left_out
        self._history.append(counts)
        recent = {name: count - self._history[0][name] for name, count in counts.items()}
        self.lost = recent['lost']
        problems = []
        skipped = max(recent['missing'] - recent['lost'], 0) + recent['skipped']
        if self.lost:
            lost = counted(self.lost, 'image')
            problems.append(f'{lost} lost in transport: {_lost_why(events)}')
        if skipped:
            said = f'{counted(skipped, "image")} skipped; {SLOW_REMEDY}'
            problems.append(f'too slow for the camera: {said}')
        elif recent['left_out'] and not recent['lost']:
            problems.append(
                f'gaps in the stamps: {counted(recent["left_out"], "image")} missing, although no '
                'message was lost; the camera, its driver or the recording dropped them'
            )
        # After a crash the graph has the old publisher for a while, beside the one that follows it.
        if recent['alternations'] > 1 and (count := len(images.publishers)) > 1:
            problems.append(f'{count} publishers on {images.topic}: their images are mixed')
        if recent['unstamped']:
            said = f'{recent["unstamped"]} images {StampReader.WHY}'
            problems.append(f'{said}: the time of their sending counts')
        if recent['errors']:
            problems.append(f'images could not be received: {events.last_error}')
        return problems

    def _values(self, images: InputState) -> dict[str, str]:
        events, statistics = images.events, self._statistics
        stamps = statistics.stamps
        spacing = stamps.spacing_ns
        return {
            'state': self.state,
            **statistics.values(),
            'frames_skipped': str(events.skipped),
            'frames_lost_in_transport': str(events.lost),
            'frames_missing': str(events.missing),
            'frames_left_out_by_stamps': str(stamps.frames_left_out),
            'stamp_rate_hz': f'{1e9 / spacing:.1f}' if spacing else 'nan',
            'stamp_jumps_back': str(self._processor.resets),
            'stamp_jumps_forward': str(stamps.jumps_forward),
            'image': statistics.image_format,
            'image_topic': images.topic,
            'calibration': self._processor.calibration,
            'image_publishers': ' '.join(images.publishers),
            'incompatible_publishers': str(events.incompatible),
        }


def explain_no_images(images: InputState, lost: int) -> str:
    """Why no images come at all, where so many were lost in the last seconds."""
    topic, publishers, events, obstacle, others = images
    if not publishers:
        return f'nothing publishes {topic}{_instead(topic, others)}'
    said = f'{", ".join(publishers)} publishes {topic}'
    if obstacle:
        return f'{said} {obstacle}'
    if lost:
        return f'{said}, but every image is lost: {_lost_why(events)}'
    return f'{said}, but no image arrives: is it paused, or its camera silent? (docs/transport.md)'


def _lost_why(events: InputEvents) -> str:
    """The likeliest cause of a loss between publisher and node, and what cures it."""
    if 0 < events.size <= _SEGMENT:
        return f'the network drops fragments of the publisher; {_OTHER_REMEDY}'
    size = f'{events.size / 1e6:.1f} MB' if events.size else 'they'
    return (
        f'{size} may not fit the shared-memory segment of the publisher, of 0.5 MB by default; '
        f'{_SEGMENT_REMEDY}'
    )


def _instead(topic: str, others: Sequence[tuple[str, str]]) -> str:
    """What there is in place of a topic that nobody publishes."""
    above, _, last = topic.rpartition('/')
    images = above if last in TRANSPORTS else topic
    beside = {'raw': (images, 'Image'), 'compressed': (f'{images}/compressed', 'CompressedImage')}
    for transport, other in beside.items():
        if other in others:
            return f'; there is {other[0]}: set image_transport to {transport}'
    if raw := [name for name, kind in others if kind == 'Image']:
        return f'; there is {", ".join(raw[:_MAX_NAMED])}: remap image_raw'
    for name, _ in others:
        if (base := name.removesuffix('/compressed')) != name:
            more = '' if last == 'compressed' else ' and set image_transport to compressed'
            return f'; there is {name}: remap image_raw to {base}{more}'
    return ''


def every_second(node: Node, action: Callable[[], None]) -> None:
    """Wall time even under use_sim_time: diagnostics must speak when the simulation stands."""
    node.create_timer(1.0, action, clock=Clock(clock_type=ClockType.STEADY_TIME))


def publish_status(node: Node, report: Callable[[], DiagnosticStatus]) -> None:
    """Have a node say once a second how it is."""
    publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)

    def publish() -> None:
        message = DiagnosticArray(status=[report()])
        message.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(message)

    every_second(node, publish)


def status(level: bytes, name: str, message: str, values: Mapping[str, str]) -> DiagnosticStatus:
    """A status with its key-values."""
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticStatus(level=level, name=name, message=message, values=pairs)


class SourceStatus:
    """Rate, state and the last trouble of a source, which is named for people."""

    def __init__(self, source: str) -> None:
        self.state = 'unconfigured'  # Or waiting for subscribers, playing, ended, retrying
        self.source = source
        self._count = self._troubles = 0
        self._published, self._recent_troubles = _Recent[None](), _Recent[None]()
        self._last_trouble = self._format = ''

    def published(self, image: Image) -> None:
        """Count a frame."""
        self._count += 1
        self._published.note(None)
        self._format = _format(image)

    def trouble(self, words: str) -> None:
        """Keep what went wrong."""
        self._troubles += 1
        # In this order: the report comes from another thread.
        self._last_trouble = words
        self._recent_troubles.note(None)

    def report(self, name: str, paused: bool, subscribers: int) -> DiagnosticStatus:
        """The node's diagnostic status."""
        state = 'paused' if paused else self.state
        level, message = DiagnosticStatus.OK, state
        if self.state == 'retrying':
            level, message = DiagnosticStatus.ERROR, self._last_trouble
        elif self._recent_troubles.all():
            level, message = DiagnosticStatus.WARN, self._last_trouble
        values = {
            'state': state,
            'source': self.source,
            'rate_hz': f'{len(self._published.all()) / WINDOW:.1f}',
            'frames_published': str(self._count),
            'image': self._format,
            'subscribers': str(subscribers),
            'troubles': str(self._troubles),
            'last_trouble': self._last_trouble,
        }
        return status(level, name, message, values)

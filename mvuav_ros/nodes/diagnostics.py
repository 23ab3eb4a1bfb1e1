"""What nodes publish on ``/diagnostics``: counts, times, and sentences that name a remedy."""

from __future__ import annotations

import statistics
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from mvuav_ros.nodes.image_input import InputEvents, InputState
from mvuav_ros.nodes.running import PROFILE
from mvuav_ros.parameters.common_parameters import TRANSPORTS
from mvuav_ros.vision.image import Image

WINDOW = 5.0
"""Seconds over which rates, latencies and recent troubles are taken."""
_LONGEST_REASON = 300
_PERCENTILES = {
    'latency_p50_ms': ('total', 50),
    'latency_p95_ms': ('total', 95),
    'latency_p99_ms': ('total', 99),
    **{f'{stage}_p50_ms': (stage, 50) for stage in ('transport', 'decode', 'process', 'publish')},
}
"""Of `FrameTimes`."""


class FrameTimes(NamedTuple):
    """Where the time of one processed frame went, s.

    Attributes:
        transport: from the publisher to us; NaN if the middleware does not say.
        decode: bytes to image.
        process: image to messages.
        publish: messages to the middleware.
        total: from taking the bytes to the last message, waiting included.
    """

    transport: float
    decode: float
    process: float
    publish: float
    total: float


class FrameStatistics:
    """What came in, what went out, how long it took and what was rejected, and why."""

    def __init__(self) -> None:
        self._arrivals: deque[float] = deque()
        self._results: deque[tuple[float, FrameTimes]] = deque()
        self._rejections: deque[float] = deque()
        self.received = 0
        self.processed = 0
        self.rejected: Counter[str] = Counter()
        self.last_reason = ''
        self.restart()

    def restart(self) -> None:
        """Images are expected from now on; counts go on."""
        for recent in (self._arrivals, self._results, self._rejections):
            recent.clear()
        self._quiet_since = time.monotonic()

    def arrived(self) -> None:
        """Count a frame."""
        self.received += 1
        self._quiet_since = time.monotonic()
        self._arrivals.append(self._quiet_since)

    def processed_one(self, times: FrameTimes) -> None:
        """Count the results of a frame."""
        self.processed += 1
        self._results.append((time.monotonic(), times))

    def reject(self, kind: str, reason: str) -> None:
        """Count a frame that got no result, by kind (``bad image``), and keep the reason."""
        self.rejected[kind] += 1
        self._rejections.append(time.monotonic())
        self.last_reason = reason[:_LONGEST_REASON]

    def problems(self) -> list[str]:
        """What was wrong with the frames of the last seconds, in words."""
        self._forget_old()
        rejected, arrived = len(self._rejections), len(self._arrivals)
        return [f'{rejected} of {arrived} images rejected: {self.last_reason}'] if rejected else []

    @property
    def silent(self) -> bool:
        """Whether no frame came within the last seconds."""
        self._forget_old()
        return not self._arrivals

    @property
    def quiet_for(self) -> float:
        """Seconds since the last frame, or since frames are expected."""
        return time.monotonic() - self._quiet_since

    def values(self) -> dict[str, str]:
        """Key-values of a diagnostic status."""
        self._forget_old()
        times = [times for _, times in self._results]
        return {
            'input_rate_hz': f'{len(self._arrivals) / WINDOW:.1f}',
            'output_rate_hz': f'{len(self._results) / WINDOW:.1f}',
            **{key: _percentile_ms(times, *which) for key, which in _PERCENTILES.items()},
            'frames_received': str(self.received),
            'frames_processed': str(self.processed),
            'frames_rejected': str(self.rejected.total()),
            **{f'rejected_{kind.replace(" ", "_")}': str(n) for kind, n in self.rejected.items()},
            'last_rejection': self.last_reason,
        }

    def _forget_old(self) -> None:
        oldest = time.monotonic() - WINDOW
        for times in (self._arrivals, self._rejections):
            while times and times[0] < oldest:
                times.popleft()
        while self._results and self._results[0][0] < oldest:
            self._results.popleft()


def _percentile_ms(times: Sequence[FrameTimes], stage: str, percent: int) -> str:
    values = [getattr(each, stage) * 1e3 for each in times]
    return f'{np.percentile(values, percent):.2f}' if values else 'nan'


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
        return round(statistics.median(self._spacings)) if len(self._spacings) >= 8 else 0


class InputMonitor:
    """Turns counters into sentences: what happened in the last seconds, and the remedy.

    Attributes:
        lost: images lost in transport in the last seconds.
    """

    def __init__(self) -> None:
        self.lost = 0
        self._history: deque[dict[str, int]] = deque(maxlen=round(WINDOW) + 1)

    def problems(self, events: InputEvents, stamps: StampMonitor) -> list[str]:
        """Sentences about the last seconds; to be called once a second."""
        counts = {
            'lost': events.lost,
            'missing': events.missing,
            'skipped': events.skipped,
            'errors': events.errors,
            'left out': stamps.frames_left_out,
        }
        self._history.append(counts)
        recent = {name: count - self._history[0][name] for name, count in counts.items()}
        self.lost = recent['lost']
        problems = []
        skipped = max(recent['missing'] - recent['lost'], 0) + recent['skipped']
        if self.lost:
            problems.append(f'{self.lost} images lost in transport: {_lost_why(events)}')
        if skipped:
            problems.append(f'too slow for the camera: {skipped} images skipped; {SLOW_REMEDY}')
        elif recent['left out'] and not recent['lost']:
            problems.append(
                f'gaps in the stamps: {recent["left out"]} images are missing, although no message '
                'was lost; the camera, its driver or the recording dropped them'
            )
        if recent['errors']:
            problems.append(f'images could not be received: {events.last_error}')
        return problems


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
    raw = [name for name, kind in others if kind == 'Image']
    return f'; there is {", ".join(raw[:_MAX_NAMED])}: remap image_raw' if raw else ''


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
    """Rate, state and the last trouble of a source.

    Attributes:
        state: ``waiting`` for subscribers, ``playing``, ``ended`` or ``retrying``; the lifecycle
            state while the node is not active.
        source: what it is, for people.
    """

    def __init__(self, source: str) -> None:
        self.state = 'unconfigured'
        self.source = source
        self._count = self._troubles = 0
        self._times: deque[float] = deque()
        self._last_trouble, self._last_trouble_at = '', -WINDOW
        self._format = ''

    def published(self, image: Image) -> None:
        """Count a frame."""
        self._count += 1
        self._times.append(time.monotonic())
        self._format = f'{image.width}x{image.height} {image.encoding}'

    def trouble(self, words: str) -> None:
        """Keep what went wrong."""
        self._troubles += 1
        self._last_trouble, self._last_trouble_at = words, time.monotonic()

    def report(self, name: str, paused: bool, subscribers: int) -> DiagnosticStatus:
        """The node's diagnostic status."""
        now = time.monotonic()
        while self._times and self._times[0] < now - WINDOW:
            self._times.popleft()
        state = 'paused' if paused else self.state
        level, message = DiagnosticStatus.OK, state
        if self.state == 'retrying':
            level, message = DiagnosticStatus.ERROR, self._last_trouble
        elif now - self._last_trouble_at < WINDOW:
            level, message = DiagnosticStatus.WARN, self._last_trouble
        values = {
            'state': state,
            'source': self.source,
            'rate_hz': f'{len(self._times) / WINDOW:.1f}',
            'frames_published': str(self._count),
            'image': self._format,
            'subscribers': str(subscribers),
            'troubles': str(self._troubles),
            'last_trouble': self._last_trouble,
        }
        return status(level, name, message, values)

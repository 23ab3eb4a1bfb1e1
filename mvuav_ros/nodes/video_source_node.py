"""``video_source``: cameras, videos, image folders and bags as ``image_raw``."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from threading import Event, Thread
from typing import TYPE_CHECKING, TypeVar

from diagnostic_msgs.msg import DiagnosticStatus
from std_srvs.srv import SetBool, Trigger

from mvuav_ros.messages.images import BadFrame, Frame
from mvuav_ros.nodes.diagnostics import SourceStatus, publish_status
from mvuav_ros.nodes.live_parameters import LiveParameters
from mvuav_ros.nodes.managed_node import ManagedNode
from mvuav_ros.nodes.publishing import FramePublisher
from mvuav_ros.parameters.video_source import VideoSourceParameters
from mvuav_ros.sources.calibration import load_calibration
from mvuav_ros.sources.files import DEFAULT_RATE
from mvuav_ros.sources.opening import open_source
from mvuav_ros.sources.source import FrameSource, SourceError
from mvuav_ros.vision.image import ImageError

if TYPE_CHECKING:
    from mvuav_ros.nodes.vision_node import VisionNode

RETRY_INTERVAL = 1.0
"""Seconds between two attempts to open a camera."""
LOG_INTERVAL = 5.0
SETTLING_TIME = 0.3
"""Seconds from the moment that we see a subscriber until it surely sees us."""
_LONGEST_GAP = 5.0
"""Seconds; a recording that pauses longer goes on after this."""
_LOOK_INTERVAL = 0.2
"""Seconds after which another rate counts for the frame that is waited for."""


class Pace:
    """Waits until a frame is due, by its stamp or at a fixed rate.

    ``rate`` gives the latter, Hz, at any moment; 0: by the stamps.
    """

    def __init__(self, rate: Callable[[], float], spacing: float = 0.0) -> None:
        """The first frame is due at once; a frame alone lasts for ``spacing``, s, by the stamps."""
        self._rate, self._spacing = rate, spacing
        self._last_stamp_ns: int | None = None
        self._due = 0.0

    def resume(self) -> None:
        """Go on from the next frame, after a pause."""
        self._last_stamp_ns = None

    def wait(self, stamp_ns: int, stop: Event) -> None:
        """Sleep until the frame of a stamp, ns, is due or ``stop`` is set."""
        last, self._last_stamp_ns = self._last_stamp_ns, stamp_ns
        if last is None:
            self._due = time.monotonic()
            return
        gap = (stamp_ns - last) * 1e-9
        if gap > 0:
            self._spacing = min(gap, _LONGEST_GAP)
        self._sleep(min(max(gap, 0.0), _LONGEST_GAP), stop)

    def wait_for_end(self, stop: Event) -> None:
        """Sleep until the last frame has lasted as long as the one before it."""
        self._sleep(self._spacing, stop)

    def _sleep(self, gap: float, stop: Event) -> None:
        before = self._due
        while True:
            rate = self._rate()
            self._due = before + (1.0 / rate if rate > 0 else gap)
            left = self._due - time.monotonic()
            if left <= 0 or stop.wait(min(left, _LOOK_INTERVAL)):
                break
        if left < -1.0:
            # Too slow for the pace: go on from here instead of racing to catch up.
            self._due -= left


class SourcePlayer:
    """Reads a source and publishes its frames when they are due."""

    def __init__(self, node: VideoSource, source: FrameSource) -> None:
        """Prepare; `start` plays, `stop` closes the source."""
        self._node, self._source, self._status = node, source, node.status
        self._stop, self._interrupt, self._running = Event(), Event(), Event()
        self._running.set()
        self._rewind = False
        self._thread = Thread(target=self._run, name='source', daemon=True)

    @property
    def paused(self) -> bool:
        """Whether it holds after the present frame, until this is set to False."""
        return not self._running.is_set()

    @paused.setter
    def paused(self, paused: bool) -> None:
        if paused:
            self._running.clear()
        else:
            self._running.set()

    def start(self) -> None:
        """Play, from the start of the source."""
        self._thread.start()

    def restart(self) -> None:
        """Play from the start again."""
        # In this order: the thread clears the interrupt once it sees the rewind.
        self._interrupt.set()
        self._rewind = True
        self._running.set()

    def stop(self) -> None:
        """End the thread and let go of the device or file."""
        self._stop.set()
        self._interrupt.set()
        self._running.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)
        self._source.close()

    def _run(self) -> None:
        try:
            self._wait_for_subscribers()
            while not self._stop.is_set():
                # In this order: of a restart between the two the rewind must not be lost.
                self._rewind = False
                self._interrupt.clear()
                self._status.state = 'playing'
                self._play()
        except Exception as error:
            if self._stop.is_set() or not self._node.context.ok():
                return
            self._node.failed = True
            words = f'{self._source.name}: {type(error).__name__}: {error}'
            self._node.get_logger().fatal(words)
            self._node.context.try_shutdown()

    def _wait_for_subscribers(self) -> None:
        wanted = self._node.current.wait_for_subscribers
        if self._source.live or wanted == 0:
            return
        if self._node.subscribers < wanted:
            self._node.get_logger().info(
                f'{self._source.name}: waiting for {wanted} subscriber(s) of image_raw '
                '(wait_for_subscribers:=0 starts at once)'
            )
        while not self._stop.is_set() and self._node.subscribers < wanted:
            self._stop.wait(0.05)
        self._stop.wait(SETTLING_TIME)

    def _play(self) -> None:
        """The source once from the start, then wait for a restart unless it loops."""
        source, count, bad = self._source, 0, 0
        pace = Pace(lambda: self._node.current.rate, 1.0 / (source.rate or DEFAULT_RATE))
        try:
            for frame in source.frames():
                if source.live and self.paused:
                    # Held back, they would be old when the camera goes on.
                    continue
                if not self._due(frame, pace):
                    return
                sent = self._send(frame)
                count, bad = count + sent, bad + (not sent)
        except SourceError as error:
            self._warn(f'{error}; trying again')
            self._status.state = 'retrying'
            self._stop.wait(RETRY_INTERVAL)
            return
        self._at_end(count, bad, pace)

    def _due(self, frame: Frame | BadFrame, pace: Pace) -> bool:
        """Wait until a frame is due; False where it is not wanted any more."""
        is_paced = not (self._source.live or isinstance(frame, BadFrame))
        while not (self._stop.is_set() or self._rewind):
            if self.paused and not self._source.live:
                self._running.wait()
                pace.resume()
            elif is_paced:
                pace.wait(frame.stamp_ns, self._interrupt)
                is_paced = self.paused
            else:
                return True
        return False

    def _send(self, frame: Frame | BadFrame) -> bool:
        try:
            if isinstance(frame, BadFrame):
                raise ImageError(frame.reason)
            self._node.publish(frame)
        except ImageError as error:
            self._warn(f'frame skipped: {error}')
            return False
        return True

    def _at_end(self, count: int, bad: int, pace: Pace) -> None:
        if errors := self._source.account.errors:
            words = '; '.join(errors)
            self._status.trouble(words)
            self._node.get_logger().warning(words)
        if self._node.current.loop and count:
            pace.wait_for_end(self._interrupt)
            return
        self._status.state = 'ended'
        skipped = f', {bad} unusable' if bad else ''
        self._node.get_logger().info(
            f'end of {self._source.name} after {count} frames{skipped}; call ~/restart to play it '
            'again, or set loop'
        )
        while not (self._stop.is_set() or self._rewind):
            # Of a source without a frame another pass would show nothing else.
            if self._node.current.loop and count:
                return
            self._interrupt.wait(0.2)

    def _warn(self, text: str) -> None:
        self._status.trouble(text)
        self._node.get_logger().warning(text, throttle_duration_sec=LOG_INTERVAL)


ResponseT = TypeVar('ResponseT', SetBool.Response, Trigger.Response)


class VideoSource(ManagedNode):
    """Publishes a source's frames from a thread of its own, so that services stay responsive."""

    _live: LiveParameters[VideoSourceParameters]

    def __init__(self, detectors: Sequence[VisionNode] = ()) -> None:
        """Make the node; ``detectors`` of this process are handed each frame it publishes."""
        super().__init__('video_source')
        self._detectors = detectors
        self._live = LiveParameters(self, VideoSourceParameters, lambda _: None)
        self._publisher: FramePublisher | None = None
        self._source: FrameSource | None = None
        self._player: SourcePlayer | None = None
        self.status = SourceStatus(self.current.source)
        publish_status(self, self._report)
        self.create_service(SetBool, '~/pause', self._on_pause)
        self.create_service(Trigger, '~/restart', self._on_restart)

    def open(self) -> None:
        """Open the source, the calibration and the topics; a camera is only named."""
        given = self.current
        self._source = self._open_source()
        calibration = load_calibration(given.camera_info_url) if given.camera_info_url else None
        if calibration is not None and self._source.is_rectified:
            calibration = calibration.rectified()
        self._publisher = FramePublisher(self, calibration, [each.take for each in self._detectors])

    def _open_source(self) -> FrameSource:
        given = self.current
        return open_source(given.source, topic=given.bag_topic or None, camera=given)

    def begin(self) -> None:
        """Take the camera, or play the recording from its start."""
        assert self._publisher is not None
        source, self._source = self._source or self._open_source(), None
        self.status.source = source.name
        self.status.state = 'waiting'
        topic = self.resolve_topic_name('image_raw')
        self.get_logger().info(f'publishing {source.name} on {topic}')
        self._player = SourcePlayer(self, source)
        self._player.start()

    def end(self) -> None:
        """Let go of the camera or the file."""
        if self._player is not None:
            self._player.stop()
            self._player = None

    def close(self) -> None:
        """Take the topics off the graph."""
        if self._source is not None:
            self._source.close()
            self._source = None
        if self._publisher is not None:
            self._publisher.destroy()
            self._publisher = None

    @property
    def current(self) -> VideoSourceParameters:
        """The parameters at this moment."""
        return self._live.current

    def publish(self, frame: Frame) -> None:
        """Send a frame; an `ImageError` where it cannot be converted."""
        assert self._publisher is not None
        self.status.published(self._publisher.publish(frame, self.current))

    @property
    def subscribers(self) -> int:
        """How many get a frame."""
        others = 0 if self._publisher is None else self._publisher.subscribers
        return others + sum(each.listens for each in self._detectors)

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if self._player is not None:
            self._player.paused = request.data
        return self._answered(response, 'paused' if request.data else 'playing')

    def _on_restart(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._player is not None:
            self._player.restart()
        return self._answered(response, f'playing {self.status.source} from the start')

    def _answered(self, response: ResponseT, done: str) -> ResponseT:
        response.success = self._player is not None
        inactive = f'the node is {self.lifecycle_state}, not active'
        response.message = done if response.success else inactive
        return response

    def _report(self) -> DiagnosticStatus:
        player = self._player
        if player is None:
            self.status.state = self.lifecycle_state
        paused = player is not None and player.paused
        return self.status.report(self.get_fully_qualified_name(), paused, self.subscribers)

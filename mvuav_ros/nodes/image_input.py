"""Images from a topic, or handed over in the same process: the newest one to be answered."""

from __future__ import annotations

import copy
import math
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from importlib import import_module
from threading import Event, Lock, Thread
from typing import Any, NamedTuple

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import (
    QoSSubscriptionEventType,
    SubscriptionEventCallbacks,
    UnsupportedEventTypeError,
)
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import (
    HistoryPolicy,
    QoSCompatibility,
    QoSPolicyKind,
    ReliabilityPolicy,
    qos_check_compatible,
    qos_profile_sensor_data,
)
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.topic_endpoint_info import TopicEndpointInfo
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu

from mvuav_ros.messages.images import (
    COMPRESSED_IMAGE,
    COMPRESSED_VIDEO,
    FFMPEG_PACKET,
    IMAGE,
    Frame,
    StampReader,
)
from mvuav_ros.messages.sensors import (
    AttitudePairing,
    CameraInfoDecoder,
    StampPairing,
    decode_imu,
    type_name,
)
from mvuav_ros.nodes.live_parameters import OVERRIDABLE
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import Attitude
from mvuav_ros.vision.image import ImageError

_DEPTH = 5
"""Frames that wait at most, as many as in the queue of a sensor subscription."""
_CALM = 5
"""Wakes with a single image after which a node that was too slow counts as fast enough again."""
_PATIENCE = 3
"""Backlogs in a row, none smaller than the one before it, after which the node is too slow."""


class ReceivedImage(NamedTuple):
    """An image, and when it came."""

    data: bytes | Frame  # a message in CDR; the frame where source and node share a process
    stamp_ns: int  # see `StampReader`
    transport: float  # seconds since it was sent, by the system clocks; NaN if unknown
    taken: float  # `time.perf_counter` when it was taken
    camera: CameraModel | None = None  # that holds for it, if one is known (see `StampPairing`)
    attitude: Attitude | None = None  # of the body at its stamp, likewise (see `AttitudePairing`)
    is_skipped: bool = False  # newer ones lay waiting; those after it may need it to be decoded
    follows_loss: bool = False  # the one before it never came, or is not known to have


@dataclass
class InputEvents:
    """What became of images before the callback; counts since the start."""

    lost: int = 0  # never arrived, as the middleware says
    missing: int = 0  # left out in the publisher's own count, for whatever reason
    skipped: int = 0  # taken, and left out as newer ones lay waiting
    size: int = 0  # of the newest image, in bytes
    alternations: int = 0  # how often an image came from another publisher, which has sent no more
    incompatible: int = 0  # publishers whose QoS did not fit ours
    unstamped: int = 0  # whose time is that of their sending
    errors: int = 0
    last_error: str = ''


class InputState(NamedTuple):
    """The image topic at this moment."""

    topic: str  # its resolved name
    publishers: list[str]  # the nodes that publish it
    events: InputEvents
    obstacle: str = ''  # why none of them can be received, in words
    others: Sequence[tuple[str, str]] = ()  # where nobody publishes it: topics that carry images


class Backlog:
    """Distinguishes a hiccup, after which every image is still answered, from being too slow."""

    def __init__(self) -> None:
        self._previous = self._not_smaller = self._calm = 0
        self._too_slow = False

    def skips(self, waiting: int) -> bool:
        """Whether all but the newest of the images that lie waiting are to be left out."""
        if waiting == 1:
            self._calm += 1
            self._not_smaller = 0
            if self._calm >= _CALM:
                self._too_slow = False
        elif waiting >= self._previous:
            self._not_smaller += 1
            if self._not_smaller >= _PATIENCE:
                self._too_slow, self._calm = True, 0
        self._previous = waiting
        return waiting > 1 and self._too_slow


TRANSPORT_TYPES = {
    'raw': IMAGE,
    'compressed': COMPRESSED_IMAGE,
    'ffmpeg': FFMPEG_PACKET,
    'foxglove': COMPRESSED_VIDEO,
}
"""Messages by the parameter ``image_transport``; a robot may lack those of the last two."""


def image_topic(transport: str, resolved: str) -> tuple[str, Any]:
    """Name, to be resolved and remapped, and class of a transport beside the topic of raw images.

    Raises:
        ParameterError: the messages' package is not installed.
    """
    package, _, kind = TRANSPORT_TYPES[transport].split('/')
    try:
        message = getattr(import_module(f'{package}.msg'), kind)
    except ImportError as error:
        raise ParameterError(
            'image_transport',
            f'{transport} needs the messages of {package}: '
            f'apt install ros-jazzy-{package.replace("_", "-")} ({error})',
        ) from error
    return 'image_raw' if transport == 'raw' else f'{resolved}/{transport}', message


def camera_info_topic(node: Node) -> str:
    """In the namespace of the images, as camera drivers have it, unless it is remapped itself."""
    topic = node.resolve_topic_name('camera_info')
    if topic == node.resolve_topic_name('camera_info', only_expand=True):
        topic = node.resolve_topic_name('image_raw').rsplit('/', 1)[0] + '/camera_info'
    return topic


def published_topics(node: Node, *kinds: type) -> list[tuple[str, str]]:
    """Topics with such messages that somebody publishes, and their types, debug images left out."""
    known = {type_name(kind): kind.__name__ for kind in kinds}
    return [
        (topic, known[types[0]])
        for topic, types in node.get_topic_names_and_types()
        if types[0] in known and '/debug' not in topic and node.count_publishers(topic) > 0
    ]


class _OwnThread(CallbackGroup):
    """Keeps the executor away."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        pass


def subscribe(
    node: Node,
    kind: type,
    topic: str,
    *,
    depth: int = _DEPTH,
    reliability: ReliabilityPolicy | None = None,
) -> Any:
    """A subscription to bytes, with the QoS of sensor data and ``qos_overrides``.

    A ``reliability`` wins over what the ``qos_overrides`` say of that.
    """
    # A copy: rclpy writes the user's overrides into it.
    qos, overridable = copy.copy(qos_profile_sensor_data), OVERRIDABLE
    qos.depth = depth
    if reliability is not None:
        qos.reliability = reliability
        others = [kind for kind in OVERRIDABLE.policy_kinds if kind != QoSPolicyKind.RELIABILITY]
        overridable = QoSOverridingOptions(others)
    return node.create_subscription(
        kind,
        topic,
        _not_called,
        qos,
        callback_group=_OwnThread(),
        # An executor that waits for a subscription's events wakes up for its data as well, on
        # Fast DDS, and again and again until this thread has taken them.
        event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        qos_overriding_options=overridable,
        raw=True,
    )


def _override(topic: str, policy: str = 'reliability') -> str:
    return f'qos_overrides.{topic}.subscription.{policy}'


def status_of(subscription: Any, name: str) -> Any:
    """A status of a subscription that can be asked for; None if not supported."""
    kind = getattr(QoSSubscriptionEventType, f'RCL_SUBSCRIPTION_{name}')
    try:
        with subscription.handle:
            return rclpy_implementation.EventHandle(subscription.handle, kind)
    except UnsupportedEventTypeError:
        return None


def _not_called(_message: Any) -> None:
    raise AssertionError('the executor does not take images')


LONGEST_HOLD = 0.1
"""Seconds that an image waits for its CameraInfo or attitude, where somebody publishes one."""
_SYNCHRONIZED_DEPTH = 200
"""Messages that may come while an image is answered: of an IMU of 1 kHz those of 0.2 s."""


class SynchronizedTopic:
    """A topic that images may wait for; used in the images' thread alone."""

    def __init__(
        self, node: Node, kind: type[CameraInfo | Imu], topic: str, is_awaited: Callable[[], bool]
    ) -> None:
        """Subscribe; ``is_awaited`` says whether images are to wait, now."""
        self.subscription = subscribe(node, kind, topic, depth=_SYNCHRONIZED_DEPTH)
        self.kind, self._is_awaited = kind, is_awaited
        self._pairing: StampPairing[Any, ReceivedImage] | AttitudePairing[ReceivedImage]
        self._decode: Callable[[bytes], tuple[int, Any]] = decode_imu
        if kind is CameraInfo:
            self._decode = CameraInfoDecoder(node.resolve_topic_name('image_raw')).decode
            self._pairing, self._field = StampPairing(), 'camera'
        else:
            self._pairing, self._field = AttitudePairing(), 'attitude'

    @property
    def holds(self) -> bool:
        """Whether an image waits."""
        return self._pairing.held is not None

    def take(self) -> None:
        """Take in what has come; what cannot be read is left, as in a recording."""
        while (taken := self.subscription.handle.take_message(self.kind, True)) is not None:
            with suppress(ImageError):
                self._pairing.add_info(*self._decode(taken[0]))

    def completed(self, images: Iterable[ReceivedImage]) -> Iterator[ReceivedImage]:
        """The images, in their order, that need not wait any more, with what belongs to them."""
        if self._pairing.is_idle:
            yield from images
            return
        for image in images:
            self._pairing.add_image(image.stamp_ns, image)
        while (found := self._pairing.take(wait=self._may_come())) is not None:
            given: dict[str, Any] = {self._field: found[0]}
            yield found[1]._replace(**given)
            # While that one was answered, what the next waits for may have come, and its time gone.
            self.take()

    def _may_come(self) -> bool:
        """Whether what the longest-held image waits for may yet come."""
        held = self._pairing.held
        if held is None or not self._is_awaited():
            return False
        is_published = self.subscription.get_publisher_count() > 0
        return is_published and time.perf_counter() < held.taken + LONGEST_HOLD


_LONGEST_WAIT_NS = 500_000_000
_REMEDY_OF_TRANSPORT = (
    'set image_transport (docs/ros.md), with image_raw remapped to the name without /compressed'
)
_OFFERED = {'best effort': ('reliability', 'best_effort'), 'volatile': ('durability', 'volatile')}
"""What a publisher offers too little of, as rclpy says it, and the override that asks for that."""
_HELD_WAIT_NS = 5_000_000
_PAUSE_AFTER_ERROR = 0.1


@dataclass(eq=False)
class FrameInput(ABC):
    """Images from wherever they come, handed on in a thread of its own with what belongs to them.

    The topics that images may wait for are closed with this.
    """

    node: Node
    name: str  # of the topic
    on_image: Callable[[ReceivedImage], None]
    synchronized: Sequence[SynchronizedTopic] = ()

    def __post_init__(self) -> None:
        self._events = InputEvents()
        self.topic = self.node.resolve_topic_name(self.name)
        self._subscriptions: list[Any] = [topic.subscription for topic in self.synchronized]
        self._stopping = Event()
        self._wake = GuardCondition(None, None, context=self.node.context)
        self._thread: Thread | None = None

    @abstractmethod
    def poll(self) -> InputState:
        """What became of images so far; to be called now and then, from one thread."""

    @abstractmethod
    def _arrived(self) -> Iterable[ReceivedImage]:
        """The images that are there."""

    def start(self) -> None:
        """Begin to take images."""
        # One for each thread: the last one may still be at an image, and is to end after it.
        stopping = self._stopping = Event()
        self._thread = Thread(target=self._run, args=(stopping,), name='images', daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread, then the subscriptions; images that come later are left."""
        self._end_thread()
        for each in self._subscriptions:
            self.node.destroy_subscription(each)
        self._wake.destroy()

    def _end_thread(self) -> None:
        self._stopping.set()
        self._wake.trigger()
        if self._thread is not None:
            self._thread.join(timeout=5.0)
            self._thread = None

    def _run(self, stopping: Event) -> None:
        while not stopping.is_set() and self.node.context.ok():
            try:
                self._take_until(stopping)
            except Exception as error:
                # Out of memory, say. The thread must outlive whatever one image brings.
                self._events.errors += 1
                self._events.last_error = f'{type(error).__name__}: {error}'
                stopping.wait(_PAUSE_AFTER_ERROR)

    def _take_until(self, stopping: Event) -> None:
        context = self.node.context.handle
        assert context is not None
        with ExitStack() as handles:
            for entity in (*self._subscriptions, self._wake):
                handles.enter_context(entity.handle)
            handles.enter_context(context)
            count = len(self._subscriptions)
            wait_set = rclpy_implementation.WaitSet(count, 1, 0, 0, 0, 0, context)
            while not stopping.is_set() and self.node.context.ok():
                wait_set.clear_entities()
                for subscription in self._subscriptions:
                    wait_set.add_subscription(subscription.handle)
                wait_set.add_guard_condition(self._wake.handle)
                holds = any(topic.holds for topic in self.synchronized)
                wait_set.wait(_HELD_WAIT_NS if holds else _LONGEST_WAIT_NS)
                # Whichever it was: to ask which ones are ready takes as long as to take them.
                for topic in self.synchronized:
                    topic.take()
                images = self._arrived()
                for topic in self.synchronized:
                    images = topic.completed(images)
                for image in images:
                    self.on_image(image)


@dataclass(eq=False)
class IntraProcessInput(FrameInput):
    """Takes frames from the source's thread; nothing is copied, as nobody writes to the pixels.

    A detector that is too slow loses the oldest frames, and the source never waits for it.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        self._waiting: deque[ReceivedImage] = deque(maxlen=_DEPTH)
        self._lock = Lock()

    def put(self, frame: Frame) -> None:
        """Give the next frame."""
        with self._lock:
            if self._stopping.is_set():
                return
            self._events.skipped += len(self._waiting) == _DEPTH
            taken_at = time.perf_counter()
            self._waiting.append(ReceivedImage(frame, frame.stamp_ns, math.nan, taken_at))
            self._wake.trigger()

    def close(self) -> None:
        """End the thread; frames that come later are left."""
        with self._lock:
            self._stopping.set()
        super().close()

    def poll(self) -> InputState:
        """What became of frames so far."""
        return InputState(self.topic, ['this process'], self._events)

    def _arrived(self) -> Iterator[ReceivedImage]:
        """One after the other: while one is answered, others may have to go."""
        while not self._stopping.is_set():
            with self._lock:
                if not self._waiting:
                    return
                image = self._waiting.popleft()
            yield image


@dataclass(eq=False)
class ImageInput(FrameInput):
    """Subscribes to images and hands over each as bytes.

    rclpy's executor collects all of a node's entities again for every single callback, and makes a
    Python object of every image. This thread waits for the images alone, as rclpy's own
    `wait_for_message` does: at 640x480 mono8 that takes half of the time and a third of the CPU.

    When the callback is slower than the camera, the newest image wins: images that lie waiting
    are skipped and counted, once it is clear that a backlog does not get smaller by itself.
    """

    kind: type = field(kw_only=True)  # of the messages, see `image_topic`

    def __post_init__(self) -> None:
        """Subscribe."""
        super().__post_init__()
        self._stamps = StampReader()
        self._lost_before = 0
        self._backlog = Backlog()
        self._subscribe()

    def _subscribe(self, reliability: ReliabilityPolicy | None = None) -> None:
        self._asked = reliability
        self._subscription = subscribe(self.node, self.kind, self.name, reliability=reliability)
        self._subscriptions = [self._subscription, *(c.subscription for c in self.synchronized)]
        self._lost = status_of(self._subscription, 'MESSAGE_LOST')
        self._incompatible = status_of(self._subscription, 'REQUESTED_INCOMPATIBLE_QOS')
        self._last_sequence, self._is_first, self._is_one = 0, True, True

    def _subscribe_anew(self, reliability: ReliabilityPolicy) -> None:
        """Ask for another reliability: publishers send again what was lost, or need not."""
        is_reliable = reliability is ReliabilityPolicy.RELIABLE
        why = 'images are lost' if is_reliable else 'no publisher is reliable any more'
        how = 'reliably' if is_reliable else 'as best effort'
        self.node.get_logger().info(f'{why}: {self.topic} is asked for {how} now')
        self._lost_before = self._events.lost
        self._end_thread()
        self.node.destroy_subscription(self._subscription)
        self._subscribe(reliability)
        self.start()

    def _end_thread(self) -> None:
        super()._end_thread()
        for event in (self._lost, self._incompatible):
            if event is not None:
                event.destroy_when_not_in_use()
        self._lost = self._incompatible = None

    def poll(self) -> InputState:
        """What became of images so far; subscribes anew where another reliability is better."""
        if self._lost is not None:
            # Without the sign: Fast DDS has begun to count at -2**31.
            total = self._lost.take_event().total_count & 0x7FFF_FFFF
            self._events.lost = self._lost_before + total
        if self._incompatible is not None:
            self._events.incompatible = int(self._incompatible.take_event().total_count)
        infos = self.node.get_publishers_info_by_topic(self.topic)
        names = [f'{info.node_namespace.rstrip("/")}/{info.node_name}' for info in infos]
        others = [] if infos else published_topics(self.node, Image, CompressedImage)
        state = InputState(self.topic, names, self._events, self._obstacle(infos), others)
        better = self._better({info.qos_profile.reliability for info in infos})
        if better is not None:
            self._subscribe_anew(better)
        return state

    def _better(self, theirs: set[ReliabilityPolicy]) -> ReliabilityPolicy | None:
        """What to ask for instead, by what the publishers offer.

        Images are lost that all of them would send again, or by then none of them would.
        """
        if self._asked is ReliabilityPolicy.RELIABLE:
            # Another camera, or the same one started otherwise: none of its images would come.
            is_none = theirs == {ReliabilityPolicy.BEST_EFFORT}
            return ReliabilityPolicy.BEST_EFFORT if is_none else None
        is_lossy = self._subscription.qos_profile.reliability != ReliabilityPolicy.RELIABLE
        gains = is_lossy and theirs == {ReliabilityPolicy.RELIABLE}
        if not gains or _override(self.topic) in self.node._parameter_overrides:
            return None
        return ReliabilityPolicy.RELIABLE if self._events.lost > self._lost_before else None

    def _obstacle(self, infos: Sequence[TopicEndpointInfo]) -> str:
        """Why no image of these publishers can come; empty where one's can."""
        wanted = type_name(self.kind)
        profile, why = self._subscription.qos_profile, ''
        for info in infos:
            level, reason = qos_check_compatible(info.qos_profile, profile)
            if info.topic_type != wanted:
                name = wanted.rsplit('/', 1)[1]
                is_image = info.topic_type in TRANSPORT_TYPES.values()
                remedy = _REMEDY_OF_TRANSPORT if is_image else 'remap image_raw'
                why = f'as {info.topic_type.rsplit("/", 1)[1]}, not {name}; {remedy}'
            elif level == QoSCompatibility.ERROR:
                reason = reason.lower().replace('error: ', '').strip(' ;')
                remedies = [
                    f'{_override(self.topic, policy)} to {value}'
                    for offered, (policy, value) in _OFFERED.items()
                    if f'{offered} publisher' in reason
                ]
                why = f'with an incompatible QoS ({reason}); set {" and ".join(remedies)}'
            else:
                return ''
        return why

    def _arrived(self) -> list[ReceivedImage]:
        images: list[ReceivedImage] = []
        take, kind = self._subscription.handle.take_message, self.kind
        # Bounded, as a publisher could be as fast as we are.
        for _ in range(self._subscription.qos_profile.depth or _DEPTH):
            taken = take(kind, True)
            if taken is None:
                break
            data, info = taken
            self._events.size = len(data)
            follows_loss = self._follow(info.get('publication_sequence_number') or 0)
            sent_ns = info.get('source_timestamp') or 0
            transport = (time.time_ns() - sent_ns) * 1e-9 if sent_ns else math.nan
            taken_at = time.perf_counter()
            stamp_ns = self._stamps.read(data, sent_ns or time.time_ns())
            self._events.unstamped = self._stamps.missing
            made = ReceivedImage(data, stamp_ns, transport, taken_at, follows_loss=follows_loss)
            images.append(made)
        return self._not_skipped(images)

    def _follow(self, sequence: int) -> bool:
        """Whether images are missing before this one of the publisher's count."""
        before, self._last_sequence = self._last_sequence, sequence
        is_first, self._is_first = self._is_first, False
        self._events.alternations += sequence <= before
        # With two publishers the counts of both are mixed, also where one of them has gone since
        # the last image, and say nothing.
        was_one, self._is_one = self._is_one, self._subscription.get_publisher_count() == 1
        if sequence > before + 1 > 1 and was_one and self._is_one:
            self._events.missing += sequence - before - 1
            return True
        return is_first

    def _not_skipped(self, images: list[ReceivedImage]) -> list[ReceivedImage]:
        """All, or the newest; those before it too, marked, where it may need them."""
        keeps_all = self._subscription.qos_profile.history == HistoryPolicy.KEEP_ALL
        if not images or keeps_all or not self._backlog.skips(len(images)):
            return images
        *older, newest = images
        self._events.skipped += len(older)
        skipped = [image._replace(is_skipped=True) for image in older]
        return [*skipped, newest] if self.kind is not Image else [newest]

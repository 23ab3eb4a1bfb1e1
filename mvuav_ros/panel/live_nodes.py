"""The processing nodes as the panel knows them, followed only while a page is open.

They are found in the ROS graph and say the rest of themselves: parameters, diagnostics, statistics.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from functools import partial
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from std_srvs.srv import Trigger

from mvuav_ros.messages.images import COMPRESSED_IMAGE, IMAGE
from mvuav_ros.messages.sensors import CAMERA_INFO, IMU, topic_beside, type_name
from mvuav_ros.panel import sanitized
from mvuav_ros.panel.controls import EVERY_NODE, Control, controls_of
from mvuav_ros.panel.ros_thread import NoAnswerError, RosThread
from mvuav_ros.parameters.declaration import Value
from mvuav_ros.processing.registry import PROCESSORS

_RESULTS = {
    processor.panel.known_by: (kind, type_name(processor.topics[processor.panel.known_by]))
    for kind, processor in PROCESSORS.items()
}
"""A node is known by a topic that only its kind publishes: the kind, and the message's type."""
_MAX_NODES = 20
_MAX_GONE = 5
"""That are shown; of more, as of a node whose every start has another name, the last ones."""
_SERVICES = {
    'list_parameters': ListParameters,
    'get_parameters': GetParameters,
    'set_parameters': SetParameters,
}
_MAX_PARAMETERS = 500
"""Shown; more are no vision node's."""
_MAX_SIDE = 100_000
_SCAN_INTERVAL = 1.0
_SILENCE = 4.0
"""Seconds without a sign of life; a killed node stays in the graph for much longer."""
_MIN_INTERVAL = 0.2
"""Seconds between two reports of a node; one that says more is not listened to all the time."""


class FoundNode(NamedTuple):
    """A running node: fully qualified name, and kind, however it is called.

    ``image_topic`` is empty where frames are handed over in its process; so are the topics of the
    calibration and the attitude where it listens to none. ``publishers`` are others in a process
    that has taken its place. ``results`` are the topics below its name, and their types.
    """

    name: str
    kind: str
    image_topic: str = ''
    compressed: bool = False
    camera_info_topic: str = ''
    imu_topic: str = ''
    publishers: frozenset[bytes] = frozenset()
    results: tuple[tuple[str, str], ...] = ()


class LiveNode:
    """One node; its parameters are asked for and set without ever waiting for it.

    It is ``alive`` while it answers, and ``unread`` while it is to be asked for its parameters;
    ``controls`` are those, in order. ``status`` are its newest diagnostics (``level`` is 0 when
    all is well), ``last_seen`` (s) says when they came; ``statistics`` are its newest
    ``~/statistics``, values by status name, which came when it ``counted`` (s).
    """

    def __init__(self, ros: RosThread, found: FoundNode) -> None:
        self.found, self.name, self.kind = found, found.name, found.kind
        self.alive, self.unread = False, True
        self.reading: asyncio.Task[None] | None = None
        self.controls: list[Control] = []
        self.values: dict[str, Any] = {}
        self.status: dict[str, str] = {}
        self.message, self.level, self.last_seen = '', 0, 0.0
        self.statistics: dict[str, dict[str, str]] = {}
        self.counted = 0.0
        self._ros = ros
        self._clients: dict[type, Any] = {}
        self._end_statistics: Callable[[], object] = lambda: None

    @property
    def image_topic(self) -> str:
        """Where its images come from."""
        said = self.status.get('image_topic', '')
        return self.found.image_topic or (said if sanitized.is_ros_name(said) else '')

    @property
    def camera_info_topic(self) -> str:
        """Where their calibration comes from; empty without images."""
        beside = topic_beside(self.image_topic, 'camera_info') if self.image_topic else ''
        return self.found.camera_info_topic or beside

    @property
    def image_size(self) -> int:
        """The longer side of its images, px; 0 while that is not known."""
        sides = map(sanitized.number, self.status.get('image', '').split(' ')[0].split('x'))
        return max((int(side) for side in sides if 0 < side <= _MAX_SIDE), default=0)

    @property
    def own_values(self) -> dict[str, Value]:
        """Its values, without what every ROS node has."""
        own = (control.name for control in self.controls if control.stage != EVERY_NODE)
        return {name: self.values[name] for name in own if self.values.get(name) is not None}

    def connect(self, counted: Callable[[LiveNode, DiagnosticArray], None]) -> None:
        """Make clients for its parameters, and subscribe to its statistics, until `disconnect`."""
        if self._clients:
            return
        client, topic = self._ros.node.create_client, f'{self.name}/statistics'
        self._clients = {kind: client(kind, f'{self.name}/{s}') for s, kind in _SERVICES.items()}
        self._end_statistics = self._ros.subscribe(
            DiagnosticArray, topic, lambda message: self._ros.call_in_loop(counted, self, message)
        )

    def disconnect(self) -> None:
        """End what `connect` has made."""
        for client in self._clients.values():
            self._ros.node.destroy_client(client)
        self._clients.clear()
        self._end_statistics()
        if self.reading:
            self.reading.cancel()

    async def ask(self, service: Any, **request: Any) -> Any:
        """Call one of its services for parameters; NoAnswerError where it does not answer."""
        if service not in self._clients:
            raise NoAnswerError('the node is gone')
        return await self._ros.request(self._clients[service], service.Request(**request))


def find_nodes(node: Node) -> dict[str, FoundNode]:
    """Ask the ROS graph."""
    found: dict[str, FoundNode] = {}
    for name, namespace in dict.fromkeys(node.get_node_names_and_namespaces()):
        full = f'{namespace.rstrip("/")}/{name}'
        # Anybody on the network can announce anything; rcl then fails in its own way.
        if not sanitized.is_ros_name(full) or len(found) >= _MAX_NODES:
            continue
        try:
            published = dict(node.get_publisher_names_and_types_by_node(name, namespace))
            subscribed = node.get_subscriber_names_and_types_by_node(name, namespace)
        except Exception as error:
            # It went away meanwhile; rclpy has no public exception for that.
            if 'NameNonExistent' not in type(error).__name__:
                raise
            continue
        for result, (kind, message) in _RESULTS.items():
            if message in published.get(f'{full}/{result}', ()):
                infos = node.get_publishers_info_by_topic(f'{full}/{result}')
                publishers = frozenset(bytes(each.endpoint_gid) for each in infos)
                below = f'{full}/'
                results = tuple(
                    (topic, types[0])
                    for topic, types in sorted(published.items())
                    if topic.startswith(below) and len(types) == 1 and sanitized.is_ros_name(topic)
                )
                found[full] = FoundNode(full, kind, *_input(subscribed), publishers, results)
    return found


def _input(subscribed: list[tuple[str, list[str]]]) -> tuple[str, bool, str, str]:
    """Topics that it listens to, see `FoundNode`, and whether its images are compressed."""
    topics: dict[str, str] = {}
    for topic, types in subscribed:
        if sanitized.is_ros_name(topic):
            topics = {**dict.fromkeys(types, topic), **topics}
    compressed = IMAGE not in topics and COMPRESSED_IMAGE in topics
    image = topics.get(COMPRESSED_IMAGE if compressed else IMAGE, '')
    return image, compressed, topics.get(CAMERA_INFO, ''), topics.get(IMU, '')


def value_of(message: Any) -> Any:
    """A rcl_interfaces/ParameterValue; None where its type is none that there is."""
    try:
        return sanitized.parameter_value(parameter_value_to_python(message))
    except RuntimeError:
        return None


def same_value(left: object, right: object) -> bool:
    """Whether two values are one; NaN is NaN here."""
    return left == right or (left != left and right != right)


Listener = Callable[[str, LiveNode], None]
"""Called in the loop with what changed: ``nodes``, ``values`` or ``status``."""


class LiveSystem:
    """Finds nodes, keeps their parameters and diagnostics up to date, and sets parameters.

    Without a listener nothing is subscribed and nothing runs.
    """

    def __init__(self, ros: RosThread) -> None:
        self._ros = ros
        self.nodes: dict[str, LiveNode] = {}
        self._listeners: set[Listener] = set()
        self._subscriptions = ExitStack()
        self._scanning: asyncio.Task[None] | None = None

    def listen(self, listener: Listener) -> None:
        """Follow the nodes until `leave`."""
        self._listeners.add(listener)
        if self._scanning is None:
            self.nodes = {name: node for name, node in self.nodes.items() if node.alive}
            for kind, topic, take in (
                (DiagnosticArray, '/diagnostics', self._on_diagnostics),
                (ParameterEvent, '/parameter_events', self._on_parameters),
            ):
                receive = partial(self._ros.call_in_loop, take)
                self._subscriptions.callback(self._ros.subscribe(kind, topic, receive, 100))
            self._scanning = asyncio.create_task(self._scan())

    def leave(self, listener: Listener) -> None:
        """End `listen`; the last one ends everything."""
        self._listeners.discard(listener)
        if not self._listeners and self._scanning is not None:
            self._scanning.cancel()
            self._scanning = None
            self._subscriptions.close()
            for node in self.nodes.values():
                node.disconnect()
                # Changes while nobody looks are not received.
                node.unread, node.last_seen = True, 0.0

    async def set(self, node: LiveNode, values: Mapping[str, Value]) -> dict[str, str]:
        """Set parameters of a node in one request; returns the reason for each that was not set."""
        try:
            messages = [Parameter(n, value=v).to_parameter_msg() for n, v in values.items()]
            results = (await node.ask(SetParameters, parameters=messages)).results
        except NoAnswerError as error:
            return dict.fromkeys(values, str(error))
        except (AssertionError, OverflowError, TypeError, ValueError) as error:
            return dict.fromkeys(values, f'cannot be sent: {sanitized.words(error)}')
        refused = {
            name: sanitized.words(said.reason.removeprefix(f'{name}: '))
            or 'refused without a reason'
            for name, said in zip(values, results, strict=False)
            if not said.successful
        }
        self._take_values(node, {k: v for k, v in values.items() if k not in refused})
        return refused

    async def trigger(self, service: str) -> str:
        """Call a std_srvs/Trigger service; returns why it failed, or nothing."""
        client = self._ros.node.create_client(Trigger, service)
        try:
            answer = await self._ros.request(client, Trigger.Request())
        except NoAnswerError as error:
            return str(error)
        finally:
            self._ros.node.destroy_client(client)
        return '' if answer.success else str(answer.message)

    async def _scan(self) -> None:
        while True:
            self._take(await asyncio.to_thread(find_nodes, self._ros.node))
            await asyncio.sleep(_SCAN_INTERVAL)

    def _take(self, found: Mapping[str, FoundNode]) -> None:
        for name, each in found.items():
            node = self.nodes.get(name)
            if node is None or node.found != each:
                node = self.nodes.setdefault(name, LiveNode(self._ros, each))
                # It may be another process, with other values, under the name of one that died.
                node.found, node.unread = each, True
                self.notify('nodes', node)
            node.connect(self._on_statistics)
            if node.unread and (node.reading is None or node.reading.done()):
                node.reading = asyncio.create_task(self._read(node))
        for name, node in self.nodes.items():
            # One whose diagnostics go elsewhere, as where each robot has its own, is never silent.
            speaks = node.last_seen and node.status
            silent = speaks and time.monotonic() - node.last_seen > _SILENCE
            if node.alive and (name not in found or silent):
                node.alive, node.unread = False, True
                self.notify('nodes', node)
            if name not in found:
                node.disconnect()
        gone = [node for name, node in self.nodes.items() if name not in found]
        for node in gone[:-_MAX_GONE]:
            del self.nodes[node.name]
            self.notify('nodes', node)

    async def _read(self, node: LiveNode) -> None:
        # One that says nothing is asked again by the next scan.
        with suppress(NoAnswerError):
            said = dict.fromkeys((await node.ask(ListParameters)).result.names)
            names = [n for n in said if 0 < len(n) <= sanitized.LONGEST_NAME][:_MAX_PARAMETERS]
            values = (await node.ask(GetParameters, names=names)).values
            node.values = dict(zip(names, map(value_of, values), strict=False))
            node.controls = controls_of(PROCESSORS[node.kind].parameters_type, node.values)
            node.alive, node.unread, node.last_seen = True, False, time.monotonic()
            self.notify('nodes', node)

    def notify(self, what: str, node: LiveNode) -> None:
        """Call the listeners."""
        for listener in list(self._listeners):
            listener(what, node)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            node, now = self.nodes.get(status.name), time.monotonic()
            if node is not None and now - node.last_seen > _MIN_INTERVAL:
                node.last_seen = now
                node.status = sanitized.key_values(status.values)
                node.message, node.level = sanitized.words(status.message), status.level[0]
                self.notify('status', node)

    def _on_statistics(self, node: LiveNode, message: DiagnosticArray) -> None:
        now = time.monotonic()
        if now - node.counted > _MIN_INTERVAL:
            node.counted = now
            node.statistics = sanitized.statuses(message)
            self.notify('status', node)

    def _on_parameters(self, event: ParameterEvent) -> None:
        node = self.nodes.get(event.node)
        if node is not None and node.controls:
            known = {control.name for control in node.controls}
            changed = [each for each in event.changed_parameters if each.name in known]
            self._take_values(node, {each.name: value_of(each.value) for each in changed})

    def _take_values(self, node: LiveNode, values: Mapping[str, Any]) -> None:
        """The answer to a request and the event of the change say the same."""
        if any(not same_value(node.values.get(name), value) for name, value in values.items()):
            node.values.update(values)
            self.notify('values', node)

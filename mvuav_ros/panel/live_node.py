"""A processing node as the panel knows it: found in the ROS graph, with what it says of itself."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python

from mvuav_ros.panel import foreign
from mvuav_ros.panel.controls import Control, control_of
from mvuav_ros.panel.ros_thread import NoAnswerError, RosThread
from mvuav_ros.parameters.declaration import Value

_RESULTS = {'markers': 'marker_tracker', 'line_params': 'runway_detector'}
"""A node is known by the point cloud that only its kind publishes."""
_MOST_NODES = 20
_CLOUD = 'sensor_msgs/msg/PointCloud2'
_RAW, _COMPRESSED = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage'
_SERVICES = {
    'list_parameters': ListParameters,
    'describe_parameters': DescribeParameters,
    'get_parameters': GetParameters,
    'set_parameters': SetParameters,
}
_MOST_PARAMETERS = 500
"""Shown; more are no vision node's."""
_LARGEST_SIDE = 100_000


class Found(NamedTuple):
    """A running node: fully qualified name, and kind, however it is called.

    ``image_topic`` is empty where frames are handed over in its process.
    """

    name: str
    kind: str
    image_topic: str = ''
    compressed: bool = False


class LiveNode:
    """One node; its parameters are asked for and set without ever waiting for it.

    It is ``alive`` while it answers, and ``unread`` while it is to be asked for its parameters;
    ``controls`` are those, in order. ``status`` are its newest diagnostics (``level`` is 0 when
    all is well), ``heard`` (s) says when they came; ``statistics`` are its newest
    ``~/statistics``, values by status name, which came when it ``counted`` (s).
    """

    def __init__(self, ros: RosThread, found: Found) -> None:
        self.found, self.name, self.kind = found, found.name, found.kind
        self.alive, self.unread = False, True
        self.reading: asyncio.Task[None] | None = None
        self.controls: list[Control] = []
        self.values: dict[str, Any] = {}
        self.status: dict[str, str] = {}
        self.message, self.level, self.heard = '', 0, 0.0
        self.statistics: dict[str, dict[str, str]] = {}
        self.counted = 0.0
        self._ros = ros
        self._clients: dict[type, Any] = {}
        self._end_statistics: Callable[[], object] = lambda: None

    @property
    def image_topic(self) -> str:
        """Where its images come from."""
        said = self.status.get('image_topic', '')
        return self.found.image_topic or (said if foreign.is_ros_name(said) else '')

    @property
    def image_size(self) -> int:
        """The longer side of its images, px; 0 while that is not known."""
        sides = map(foreign.number, self.status.get('image', '').split(' ')[0].split('x'))
        return max((int(side) for side in sides if 0 < side <= _LARGEST_SIDE), default=0)

    @property
    def own_values(self) -> dict[str, Value]:
        """Its values, without what every ROS node has."""
        own = (control.name for control in self.controls if not control.foreign)
        return {name: self.values[name] for name in own if self.values.get(name) is not None}

    def connect(self, counted: Callable[[LiveNode, DiagnosticArray], None]) -> None:
        """Make clients for its parameters, and hear its statistics, until `disconnect`."""
        if self._clients:
            return
        client, topic = self._ros.node.create_client, f'{self.name}/statistics'
        self._clients = {kind: client(kind, f'{self.name}/{s}') for s, kind in _SERVICES.items()}
        self._end_statistics = self._ros.subscribe(
            DiagnosticArray, topic, lambda message: self._ros.tell(counted, self, message)
        )

    def disconnect(self) -> None:
        """End what `connect` has made."""
        for client in self._clients.values():
            self._ros.node.destroy_client(client)
        self._clients.clear()
        self._end_statistics()
        if self.reading:
            self.reading.cancel()

    async def read(self) -> None:
        """Ask it for everything; NoAnswerError where it does not answer.

        The controls come in the order of declaration where it keeps that.
        """
        said = dict.fromkeys((await self._ask(ListParameters)).result.names)
        names = [n for n in said if 0 < len(n) <= foreign.LONGEST_NAME][:_MOST_PARAMETERS]
        described = (await self._ask(DescribeParameters, names=names)).descriptors
        controls = {each.name: control_of(each) for each in described}
        names = [name for name in names if name in controls]
        values = (await self._ask(GetParameters, names=names)).values
        self.controls = [controls[name] for name in names]
        self.values = dict(zip(names, map(value_of, values), strict=False))
        self.alive, self.unread, self.heard = True, False, time.monotonic()

    async def set(self, values: Mapping[str, Value]) -> dict[str, str]:
        """Set values in one request; returns the reason for each that was not set."""
        try:
            messages = [Parameter(n, value=v).to_parameter_msg() for n, v in values.items()]
            results = (await self._ask(SetParameters, parameters=messages)).results
        except NoAnswerError as error:
            return dict.fromkeys(values, str(error))
        except (AssertionError, OverflowError, TypeError, ValueError) as error:
            return dict.fromkeys(values, f'cannot be sent: {foreign.words(error)}')
        return {
            name: foreign.words(said.reason.removeprefix(f'{name}: ')) or 'refused without a reason'
            for name, said in zip(values, results, strict=False)
            if not said.successful
        }

    async def _ask(self, service: Any, **request: Any) -> Any:
        if service not in self._clients:
            raise NoAnswerError('the node is gone')
        return await self._ros.request(self._clients[service], service.Request(**request))


def find_nodes(node: Node) -> dict[str, Found]:
    """Ask the ROS graph."""
    found: dict[str, Found] = {}
    for name, namespace in dict.fromkeys(node.get_node_names_and_namespaces()):
        full = f'{namespace.rstrip("/")}/{name}'
        # Anybody on the network can announce anything; rcl then fails in its own way.
        if not foreign.is_ros_name(full) or len(found) >= _MOST_NODES:
            continue
        try:
            published = dict(node.get_publisher_names_and_types_by_node(name, namespace))
            subscribed = node.get_subscriber_names_and_types_by_node(name, namespace)
        except Exception as error:
            # It went away meanwhile; rclpy has no public exception for that.
            if 'NameNonExistent' not in type(error).__name__:
                raise
            continue
        for result, kind in _RESULTS.items():
            if _CLOUD in published.get(f'{full}/{result}', ()):
                found[full] = Found(full, kind, *_input(subscribed))
    return found


def _input(subscribed: list[tuple[str, list[str]]]) -> tuple[str, bool]:
    """The topic of its images, and whether they are compressed."""
    for topic, types in subscribed:
        if (_RAW in types or _COMPRESSED in types) and foreign.is_ros_name(topic):
            return topic, _COMPRESSED in types
    return '', False


def value_of(message: Any) -> Any:
    """A rcl_interfaces/ParameterValue; None where its type is none that there is."""
    try:
        return foreign.parameter_value(parameter_value_to_python(message))
    except RuntimeError:
        return None


def same_value(left: object, right: object) -> bool:
    """Whether two values are one; NaN is NaN here."""
    return left == right or (left != left and right != right)

"""The running nodes as the page sees them, followed only while a page is open."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterEvent
from std_srvs.srv import Trigger

from mvuav_ros.panel import foreign
from mvuav_ros.panel.controls import Control
from mvuav_ros.panel.discovery import Found, find_nodes
from mvuav_ros.panel.remote_parameters import RemoteParameters, value_of
from mvuav_ros.panel.ros_thread import NoAnswerError, RosThread, Subscriptions
from mvuav_ros.parameters.declaration import Value

_SCAN_INTERVAL = 1.0
_SILENCE = 4.0
"""Seconds without a sign of life; a killed node stays in the graph for much longer."""
_SHORTEST = 0.2
"""Seconds between two reports of a node; one that says more is not listened to all the time."""
_LARGEST_SIDE = 100_000


@dataclass
class LiveNode:
    """One node.

    Attributes:
        found: its name, kind and input.
        alive: it answers.
        controls: its parameters, in order; empty until it has told them.
        values: their current values.
        status: its newest diagnostics.
        message: the words of those.
        level: their level, 0 when all is well.
        statistics: its newest ``~/statistics``, values by status name.
        heard: when its newest diagnostics came, s.
        counted: when its newest statistics came, s.
    """

    found: Found
    alive: bool = False
    controls: list[Control] = field(default_factory=list)
    values: dict[str, Any] = field(default_factory=dict)
    status: dict[str, str] = field(default_factory=dict)
    message: str = ''
    level: int = 0
    statistics: dict[str, dict[str, str]] = field(default_factory=dict)
    heard: float = 0.0
    counted: float = 0.0

    @property
    def name(self) -> str:
        """Fully qualified."""
        return self.found.name

    @property
    def kind(self) -> str:
        """What it is, however it is called."""
        return self.found.kind

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


def same_value(left: object, right: object) -> bool:
    """Whether two values are one; NaN is NaN here."""
    return left == right or (left != left and right != right)


Listener = Callable[[str, LiveNode], None]
"""Called in the loop with what changed: ``nodes``, ``values``, ``status`` or ``statistics``."""


class LiveSystem:
    """Finds nodes, keeps their parameters and diagnostics up to date, and sets parameters.

    Without a listener nothing is subscribed and nothing runs.
    """

    def __init__(self, ros: RosThread) -> None:
        self._ros = ros
        self.nodes: dict[str, LiveNode] = {}
        self._remotes: dict[str, RemoteParameters] = {}
        self._listeners: list[Listener] = []
        self._subscriptions = Subscriptions(ros.node)
        self._statistics: dict[str, Subscriptions] = {}
        self._scanning: asyncio.Task[None] | None = None
        self._reading: set[str] = set()
        self._unread: set[str] = set()

    def listen(self, listener: Listener) -> None:
        """Follow the nodes until `leave`."""
        if listener not in self._listeners:
            self._listeners.append(listener)
        if self._scanning is None:
            self.nodes = {name: node for name, node in self.nodes.items() if node.alive}
            self._scanning = asyncio.create_task(self._follow())

    def leave(self, listener: Listener) -> None:
        """End `listen`; the last one ends everything."""
        if listener in self._listeners:
            self._listeners.remove(listener)
        if not self._listeners and self._scanning is not None:
            self._scanning.cancel()
            self._scanning = None
            # What changes while nobody looks is not heard of.
            self._unread = set(self.nodes)
            for node in self.nodes.values():
                node.heard = 0.0

    async def set(self, name: str, values: Mapping[str, Value]) -> dict[str, str]:
        """Set parameters of a node.

        Returns:
            For each that was not set the reason.
        """
        remote, node = self._remotes.get(name), self.nodes.get(name)
        if remote is None or node is None:
            return dict.fromkeys(values, 'the node is gone')
        try:
            refused = await remote.set(values)
        except NoAnswerError as error:
            return dict.fromkeys(values, str(error))
        self._take_values(node, {k: v for k, v in values.items() if k not in refused})
        return refused

    async def trigger(self, service: str) -> str:
        """Call a std_srvs/Trigger service; returns why it failed, or nothing."""
        client = await self._ros.call(lambda: self._ros.node.create_client(Trigger, service))
        try:
            for _ in range(20):
                if client.service_is_ready():
                    break
                await asyncio.sleep(0.05)
            answer = await self._ros.request(client, Trigger.Request())
        except NoAnswerError as error:
            return str(error)
        finally:
            await self._ros.call(lambda: self._ros.node.destroy_client(client))
        return '' if answer.success else str(answer.message)

    async def _follow(self) -> None:
        await self._ros.call(self._subscribe)
        try:
            while True:
                found = await self._ros.call(lambda: find_nodes(self._ros.node))
                await self._take(found)
                await asyncio.sleep(_SCAN_INTERVAL)
        finally:
            # The loop must get there even though this task is cancelled.
            self._scanning_ended = asyncio.ensure_future(self._ros.call(self._unsubscribe))

    async def _take(self, found: Mapping[str, Found]) -> None:
        now = time.monotonic()
        for name, each in found.items():
            node = self.nodes.get(name)
            if node is None or node.found != each:
                node = self.nodes.setdefault(name, LiveNode(each))
                node.found = each
                self._tell('nodes', node)
            if name not in self._remotes:
                await self._ros.call(partial(self._connect, name))
            if (not node.alive or name in self._unread) and name not in self._reading:
                self._reading.add(name)
                asyncio.create_task(self._read(node))  # noqa: RUF006 - kept in _reading
        for name, node in self.nodes.items():
            silent = node.heard and now - node.heard > _SILENCE
            if node.alive and (name not in found or silent):
                node.alive = False
                self._tell('nodes', node)
            if name not in found and name in self._remotes:
                await self._ros.call(partial(self._disconnect, name))

    async def _read(self, node: LiveNode) -> None:
        """Ask a node for everything; one that is gone is asked again by the next scan."""
        remote = self._remotes.get(node.name)
        try:
            if remote is not None:
                controls = await remote.describe()
                values = await remote.get([control.name for control in controls])
                node.controls, node.values = controls, values
                node.alive, node.heard = True, time.monotonic()
                self._unread.discard(node.name)
                self._tell('nodes', node)
                self._tell('values', node)
        except NoAnswerError:
            pass
        finally:
            self._reading.discard(node.name)

    def _tell(self, what: str, node: LiveNode) -> None:
        for listener in list(self._listeners):
            listener(what, node)

    # In the ROS thread:

    def _connect(self, name: str) -> None:
        heard = partial(self._ros.tell, self._on_statistics, name)
        self._statistics[name] = Subscriptions(self._ros.node)
        self._statistics[name].add(DiagnosticArray, f'{name}/statistics', heard)
        self._remotes[name] = RemoteParameters(self._ros, name)

    def _disconnect(self, name: str) -> None:
        self._statistics.pop(name).close()
        self._remotes.pop(name).close()

    def _subscribe(self) -> None:
        add, tell = self._subscriptions.add, self._ros.tell
        add(DiagnosticArray, '/diagnostics', partial(tell, self._on_diagnostics))
        add(ParameterEvent, '/parameter_events', partial(tell, self._on_parameters), 100)

    def _unsubscribe(self) -> None:
        self._subscriptions.close()
        for name in list(self._remotes):
            self._disconnect(name)

    # In the loop again:

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            node, now = self.nodes.get(status.name), time.monotonic()
            if node is not None and now - node.heard > _SHORTEST:
                node.heard = now
                node.status = foreign.key_values(status.values)
                node.message, node.level = foreign.words(status.message), status.level[0]
                self._tell('status', node)

    def _on_statistics(self, name: str, message: DiagnosticArray) -> None:
        node, now = self.nodes.get(name), time.monotonic()
        if node is not None and now - node.counted > _SHORTEST:
            node.counted = now
            node.statistics = foreign.statuses(message)
            self._tell('statistics', node)

    def _on_parameters(self, event: ParameterEvent) -> None:
        node = self.nodes.get(event.node)
        if node is not None and node.controls:
            known = {control.name for control in node.controls}
            changed = [each for each in event.changed_parameters if each.name in known]
            self._take_values(node, {each.name: value_of(each.value) for each in changed})

    def _take_values(self, node: LiveNode, values: Mapping[str, Any]) -> None:
        """The answer to a request and the event of the change tell the same."""
        if any(not same_value(node.values.get(name), value) for name, value in values.items()):
            node.values.update(values)
            self._tell('values', node)

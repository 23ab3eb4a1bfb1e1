"""The running nodes as the page sees them, followed only while a page is open."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterEvent
from std_srvs.srv import Trigger

from mvuav_ros.panel import foreign
from mvuav_ros.panel.live_node import Found, LiveNode, find_nodes, same_value, value_of
from mvuav_ros.panel.ros_thread import NoAnswerError, RosThread
from mvuav_ros.parameters.declaration import Value

_SCAN_INTERVAL = 1.0
_SILENCE = 4.0
"""Seconds without a sign of life; a killed node stays in the graph for much longer."""
_SHORTEST = 0.2
"""Seconds between two reports of a node; one that says more is not listened to all the time."""

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
                heard = partial(self._ros.tell, take)
                self._subscriptions.callback(self._ros.subscribe(kind, topic, heard, 100))
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
                # What changes while nobody looks is not heard of.
                node.unread, node.heard = True, 0.0

    async def set(self, node: LiveNode, values: Mapping[str, Value]) -> dict[str, str]:
        """Set parameters of a node; returns for each that was not set the reason."""
        refused = await node.set(values)
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

    def _take(self, found: Mapping[str, Found]) -> None:
        for name, each in found.items():
            node = self.nodes.get(name)
            if node is None or node.found != each:
                node = self.nodes.setdefault(name, LiveNode(self._ros, each))
                node.found = each
                self.tell('nodes', node)
            node.connect(self._on_statistics)
            if node.unread and (node.reading is None or node.reading.done()):
                node.reading = asyncio.create_task(self._read(node))
        for name, node in self.nodes.items():
            silent = node.heard and time.monotonic() - node.heard > _SILENCE
            if node.alive and (name not in found or silent):
                node.alive, node.unread = False, True
                self.tell('nodes', node)
            if name not in found:
                node.disconnect()

    async def _read(self, node: LiveNode) -> None:
        """One that says nothing is asked again by the next scan."""
        with suppress(NoAnswerError):
            await node.read()
            self.tell('nodes', node)
            self.tell('values', node)

    def tell(self, what: str, node: LiveNode) -> None:
        """Call the listeners."""
        for listener in list(self._listeners):
            listener(what, node)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            node, now = self.nodes.get(status.name), time.monotonic()
            if node is not None and now - node.heard > _SHORTEST:
                node.heard = now
                node.status = foreign.key_values(status.values)
                node.message, node.level = foreign.words(status.message), status.level[0]
                self.tell('status', node)

    def _on_statistics(self, node: LiveNode, message: DiagnosticArray) -> None:
        now = time.monotonic()
        if now - node.counted > _SHORTEST:
            node.counted = now
            node.statistics = foreign.statuses(message)
            self.tell('status', node)

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
            self.tell('values', node)

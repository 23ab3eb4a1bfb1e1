"""Our own ROS node, spun by a thread beside the asyncio loop that serves the pages."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from functools import partial
from typing import Any

import rclpy
from rclpy.exceptions import InvalidHandle
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

from mvuav_ros.messages.sensors import type_name

_PATIENCE = 3.0
"""Seconds that a service may take to be found and to answer."""


class NoAnswerError(RuntimeError):
    """A node did not answer in time."""


class OtherTypeError(RuntimeError):
    """A topic cannot be subscribed: DDS allows it one type in one process, which is another one."""


class RosThread:
    """Spins one node, whose callbacks use `call_in_loop`; all else is called from the loop.

    rclpy lets other threads make and end subscriptions and clients while one spins.
    """

    def __init__(self, name: str) -> None:
        """Start ROS, with its arguments on the command line, and a node of this name."""
        # Signals belong to the web server, which ends us in order.
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self.node: Node = rclpy.create_node(name)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, name='ros', daemon=True)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stopping = False

    def start(self) -> None:
        """Begin to spin; `call_in_loop` reaches the loop in which this is called."""
        self._loop = asyncio.get_running_loop()
        self._thread.start()

    def stop(self) -> None:
        """End the thread and the node."""
        self._stopping = True
        self._executor.create_task(lambda: None)
        if self._thread.is_alive():
            self._thread.join(2.0)
        self._executor.shutdown(timeout_sec=1.0)
        self.node.destroy_node()
        rclpy.try_shutdown()

    def call_in_loop(self, function: Callable[..., object], *arguments: object) -> None:
        """Have the loop call a function; from the ROS thread."""
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(function, *arguments)

    def subscribe(
        self,
        kind: type,
        topic: str,
        on_message: Callable[[Any], None],
        qos: QoSProfile | int = 10,
        *,
        raw: bool = False,
    ) -> Callable[[], object]:
        """Subscribe until the returned is called; ``on_message`` is called in the ROS thread.

        OtherTypeError where this process takes the topic for another type.
        """
        try:
            made = self.node.create_subscription(kind, topic, on_message, qos, raw=raw)
        except rclpy_implementation.RCLError as error:
            said = f'{topic} is no {type_name(kind)}: this panel takes it for another type'
            raise OtherTypeError(said) from error
        return partial(self.node.destroy_subscription, made)

    async def request(self, client: Any, request: Any) -> Any:
        """Ask a service; NoAnswerError where nothing comes in time."""
        answer: asyncio.Future[Any] = asyncio.get_running_loop().create_future()

        def take(response: Any) -> None:
            # It may come after nobody waits any more.
            if not answer.done():
                answer.set_result(response)

        try:
            async with asyncio.timeout(_PATIENCE):
                while not client.service_is_ready():
                    await asyncio.sleep(0.05)
                asked = client.call_async(request)
                asked.add_done_callback(lambda done: self.call_in_loop(take, done.result()))
                return await answer
        except TimeoutError:
            raise NoAnswerError(f'the node did not answer within {_PATIENCE:g} s') from None
        except InvalidHandle:
            raise NoAnswerError('the node is gone') from None

    def _spin(self) -> None:
        while rclpy.ok() and not self._stopping:
            try:
                self._executor.spin_once()
            except InvalidHandle:
                # The loop has just ended what was to be waited for: wait for the others.
                continue
            except Exception as error:
                # One strange message must not end the panel; the end of ROS does.
                if rclpy.ok():
                    self.node.get_logger().error(f'{type(error).__name__}: {error}')

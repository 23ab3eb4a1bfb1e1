"""A ROS node in a thread of its own beside an asyncio loop."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

T = TypeVar('T')


class NoAnswerError(RuntimeError):
    """A node did not answer in time."""


class Subscriptions:
    """Those of one purpose, which end together; used in the ROS thread."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._open: list[Any] = []

    def add(
        self,
        kind: type,
        topic: str,
        heard: Callable[[Any], None],
        qos: QoSProfile | int = 10,
        *,
        raw: bool = False,
    ) -> None:
        """Subscribe."""
        self._open.append(self._node.create_subscription(kind, topic, heard, qos, raw=raw))

    def close(self) -> None:
        """Unsubscribe from all."""
        while self._open:
            self._node.destroy_subscription(self._open.pop())


class RosThread:
    """Spins one node. Everything of ROS is done in its thread, the loop never waits for it."""

    def __init__(self, name: str, arguments: list[str]) -> None:
        """Start ROS.

        Args:
            name: of the node.
            arguments: of the command line, with ``--ros-args``.
        """
        # Signals belong to the web server, which ends us in order.
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        self.node: Node = rclpy.create_node(name)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, name='ros', daemon=True)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stopping = False

    def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Begin to spin; `tell` reaches this loop from then on."""
        self._loop = loop
        self._thread.start()

    def stop(self) -> None:
        """End the thread and the node."""
        self._stopping = True
        self._executor.create_task(lambda: None)
        self._thread.join(2.0)
        self._executor.shutdown(timeout_sec=1.0)
        self.node.destroy_node()
        rclpy.try_shutdown()

    def tell(self, function: Callable[..., object], *arguments: object) -> None:
        """Have the loop call a function; from the ROS thread."""
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(function, *arguments)

    def do(self, function: Callable[[], object]) -> None:
        """Call a function in the ROS thread and do not wait for it."""
        self._executor.create_task(function)

    async def call(self, function: Callable[[], T]) -> T:
        """Call a function in the ROS thread; from the loop."""
        value: T = await self._answer(lambda answer: answer.set_result(function()))
        return value

    async def request(self, client: Any, request: Any, timeout: float = 3.0) -> Any:
        """Ask a service; from the loop.

        Raises:
            NoAnswerError: nothing came within ``timeout`` seconds.
        """

        def ask(answer: Future[Any]) -> None:
            if not client.service_is_ready():
                raise NoAnswerError('the node does not answer')
            asked = client.call_async(request)
            asked.add_done_callback(lambda answered: answer.set_result(answered.result()))

        try:
            return await asyncio.wait_for(self._answer(ask), timeout)
        except TimeoutError:
            raise NoAnswerError(f'the node did not answer within {timeout:g} s') from None

    async def _answer(self, begin: Callable[[Future[Any]], None]) -> Any:
        answer: Future[Any] = Future()
        # From now on it cannot be cancelled: an answer may come after nobody waits any more.
        answer.set_running_or_notify_cancel()

        def run() -> None:
            try:
                begin(answer)
            except Exception as error:
                answer.set_exception(error)

        self._executor.create_task(run)
        return await asyncio.wrap_future(answer)

    def _spin(self) -> None:
        while rclpy.ok() and not self._stopping:
            try:
                self._executor.spin_once()
            except (ExternalShutdownException, KeyboardInterrupt):
                break
            except Exception as error:
                if not rclpy.ok():
                    break
                # One strange message must not end the panel.
                self.node.get_logger().error(f'{type(error).__name__}: {error}')

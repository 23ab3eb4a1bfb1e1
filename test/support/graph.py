"""Real nodes in processes of their own, and a probe that talks to them over real DDS."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CompressedImage
from sensor_msgs.msg import Image as RosImage

from mvuav_ros.cli.node_processes import claim_domain
from mvuav_ros.nodes.running import prepare_transport
from mvuav_ros.vision.image import Image
from support.node_outputs import image_of
from support.places import ROOT

# Before our own process chooses its transport: each node is to choose for itself.
CLEAN = dict(os.environ)
EVERYTHING = QoSProfile(
    history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE, depth=1
)


class Graph:
    """A ROS domain of its own with the processes started in it."""

    def __init__(self) -> None:
        self.domain_id, self._claim = claim_domain()
        self._processes: list[subprocess.Popen[str]] = []
        self._others: list[tuple[SingleThreadedExecutor, threading.Thread, Any]] = []
        prepare_transport()
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=self.domain_id)
        self.probe = rclpy.create_node('probe', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.probe)
        self.received: dict[str, list[Any]] = defaultdict(list)
        self._image_publisher = None

    def add_node(self, name: str) -> Any:
        """One more node of ours, without parameter services; spins by itself until the end."""
        node = rclpy.create_node(name, context=self._context, start_parameter_services=False)
        executor = SingleThreadedExecutor(context=self._context)
        executor.add_node(node)
        thread = threading.Thread(target=executor.spin, daemon=True)
        thread.start()
        self._others.append((executor, thread, node))
        return node

    def close(self) -> None:
        for process in self._processes:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        for process in self._processes:
            try:
                process.communicate(timeout=10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()
        self._executor.shutdown()
        for executor, thread, node in self._others:
            executor.shutdown()
            thread.join(5.0)
            node.destroy_node()
        self.probe.destroy_node()
        rclpy.shutdown(context=self._context)
        self._claim.close()

    def start(
        self,
        executable: str,
        *,
        remap: tuple[str, ...] = (),
        environment: dict[str, str] | None = None,
        wait_for: str = '',
        **parameters: Any,
    ):
        """Start an executable of the package as a user would, and wait until its node answers."""
        process = self.spawn(executable, remap=remap, environment=environment, **parameters)
        name = wait_for or executable
        self.until(lambda: name in self.probe.get_node_names(), f'{name} to appear')
        client = self.probe.create_client(GetParameters, f'/{name}/get_parameters')
        self.until(client.service_is_ready, f'{executable} to answer')
        return process

    def spawn(
        self,
        executable: str,
        *,
        remap: tuple[str, ...] = (),
        environment: dict[str, str] | None = None,
        arguments: tuple[str, ...] = (),
        **parameters: Any,
    ):
        command = [sys.executable, '-m', 'mvuav_ros', executable, *arguments, '--ros-args']
        for name, value in parameters.items():
            command += ['-p', f'{name}:={value}']
        for rule in remap:
            command += ['-r', rule]
        process = subprocess.Popen(
            command,
            cwd=ROOT,
            env={**CLEAN, 'ROS_DOMAIN_ID': str(self.domain_id), **(environment or {})},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self._processes.append(process)
        return process

    def listen(
        self, topic: str, kind: type, qos: QoSProfile = EVERYTHING, *, raw: bool = False
    ) -> list[Any]:
        """Collect a topic's messages, or their bytes, from now on; waits for its publisher."""
        messages = self.received[topic]
        self.probe.create_subscription(kind, topic, messages.append, qos, raw=raw)
        self.until(lambda: self.probe.count_publishers(topic) > 0, f'a publisher of {topic}')
        self.spin(0.3)
        return messages

    def publish_images(
        self, messages: list[RosImage | CompressedImage], topic='/image_raw', hz=50.0
    ):
        """Publish to a node that is already there, reliably."""
        if self._image_publisher is None:
            self._image_publisher = self.probe.create_publisher(
                type(messages[0]), topic, QoSProfile(depth=1000)
            )
            self.until(
                lambda: self._image_publisher.get_subscription_count() > 0,
                f'a subscriber of {topic}',
            )
            self.spin(0.3)
        for message in messages:
            self._image_publisher.publish(message)
            self.spin(1.0 / hz)

    def spin(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)

    def until_silent(self, messages: list[Any]) -> None:
        """Wait until what was on its way has come."""
        count = -1
        while count != len(messages):
            count = len(messages)
            self.spin(0.3)

    def until(
        self,
        condition: Callable[[], bool],
        what: str | Callable[[], str],
        timeout: float = 120.0,
    ) -> None:
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                output = ''
                for process in self._processes:
                    if process.poll() is not None:
                        output += process.communicate()[0]
                words = what() if callable(what) else what
                raise AssertionError(f'waited {timeout} s in vain for {words}\n{output}')
            self._executor.spin_once(timeout_sec=0.02)

    def call(self, kind: type, name: str, request: Any) -> Any:
        client = self.probe.create_client(kind, name)
        self.until(client.service_is_ready, name)
        future = client.call_async(request)
        self.until(future.done, f'an answer of {name}')
        self.probe.destroy_client(client)
        return future.result()

    def set_parameter(self, node: str, name: str, value: Any) -> Any:
        """What `ros2 param set` calls; returns the result with its reason."""
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
        return self.call(SetParameters, f'/{node}/set_parameters', request).results[0]

    def get_parameter(self, node: str, name: str) -> Any:
        request = GetParameters.Request(names=[name])
        (value,) = self.call(GetParameters, f'/{node}/get_parameters', request).values
        return rclpy.parameter.parameter_value_to_python(value)

    def describe_parameters(self, node: str, names: list[str]) -> list[Any]:
        request = DescribeParameters.Request(names=names)
        return self.call(DescribeParameters, f'/{node}/describe_parameters', request).descriptors

    def diagnostics(self, node: str) -> dict[str, str]:
        """The next diagnostic status of a node, its level under the key 'level'."""
        if '/diagnostics' not in self.received:
            self.listen('/diagnostics', DiagnosticArray)
        messages = self.received['/diagnostics']
        messages.clear()

        def newest():
            for message in messages:
                for status in message.status:
                    if status.name == f'/{node}':
                        return status
            return None

        self.until(lambda: newest() is not None, f'diagnostics of {node}')
        status = newest()
        values = {pair.key: pair.value for pair in status.values}
        return {**values, 'level': status.level[0], 'message': status.message}


def image_message(pixels, index: int, *, hz: float = 30.0, frame_id: str = 'nose') -> RosImage:
    """Frame ``index`` of a flight, mono8 or bgr8."""
    encoding = 'mono8' if pixels.ndim == 2 else 'bgr8'
    stamp_ns = 1_700_000_000_000_000_000 + round(index * 1e9 / hz)
    return image_of(Image(pixels, encoding), stamp_ns, frame_id)

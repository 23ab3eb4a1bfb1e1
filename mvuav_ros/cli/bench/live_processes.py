"""The processes of ``mvuav bench live`` beside the nodes: ``camera`` and ``floor``."""

from __future__ import annotations

import json
import struct
import sys
import time
from functools import partial
from itertools import cycle
from threading import Thread
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CompressedImage, PointCloud2
from sensor_msgs.msg import Image as RosImage

from mvuav_ros.cli.bench.live import FLOOR
from mvuav_ros.cli.bench.scenes import FRAMES, lights_above_runway
from mvuav_ros.messages.cdr import STAMP_END, STAMP_START, cdr_header, stamp_ns_in
from mvuav_ros.messages.images import serialize_image, serialize_jpeg
from mvuav_ros.messages.sensors import stamp_ns_of
from mvuav_ros.nodes.publishing import as_encoding
from mvuav_ros.nodes.running import prepare_transport, until_stopped
from mvuav_ros.processing.process_tuning import tune_process
from mvuav_ros.vision.image import Image

RESULTS = {'marker_tracker': 'markers', 'runway_detector': 'line_params', FLOOR: 'answers'}
_RESULT_BYTES = 400
"""Of the rows of five markers."""
WARM_UP = 1.0
"""Seconds of images before those that count."""
_STREAMS = {'raw': (RosImage, 'image_raw'), 'compressed': (CompressedImage, 'image_raw/compressed')}
"""Type and topic of the images by transport."""


def _stamped(message: bytes, stamp_ns: int) -> bytes:
    stamp = struct.pack('<iI', *divmod(stamp_ns, 1_000_000_000))
    return b''.join((message[:STAMP_START], stamp, memoryview(message)[STAMP_END:]))


def floor(transport: str) -> None:
    """Do the least that any rclpy node does with an image: take it, and answer at once.

    The answer is as large as a result. When interrupted, print when each image came (ns) by its
    stamp as JSON.
    """
    arrivals: dict[int, int] = {}
    answer = serialize_message(PointCloud2(data=bytes(_RESULT_BYTES)))

    def take(message: RosImage | CompressedImage) -> None:
        now = time.time_ns()
        stamp_ns = stamp_ns_of(message.header)
        arrivals[stamp_ns] = now
        answers.publish(_stamped(answer, stamp_ns))

    with until_stopped(FLOOR) as node:
        answers = node.create_publisher(PointCloud2, f'/{FLOOR}/{RESULTS[FLOOR]}', 10)
        node.create_subscription(*_STREAMS[transport], take, qos_profile_sensor_data)
        rclpy.spin(node)
    print(json.dumps(arrivals))


def camera(orders: str) -> None:
    """Publish images for a while; print which results came back as JSON."""
    given = json.loads(orders)
    tune_process()
    prepare_transport()
    rclpy.init()
    node = rclpy.create_node('bench_camera')
    results: dict[str, dict[int, int]] = {name: {} for name in (*given['nodes'], FLOOR)}
    status: dict[str, dict[str, str]] = {}
    for name, answers in results.items():
        topic, keep = f'/{name}/{RESULTS[name]}', partial(_keep_arrival, answers)
        node.create_subscription(PointCloud2, topic, keep, QoSProfile(depth=100), raw=True)
    node.create_subscription(DiagnosticArray, '/diagnostics', partial(_keep_status, status), 10)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    Thread(target=executor.spin, daemon=True).start()
    sent = _publish(node, given)
    time.sleep(0.3)
    print('end', flush=True)
    # The next diagnostics.
    time.sleep(1.2)
    executor.shutdown()
    print(json.dumps({'sent': sent, 'results': results, 'status': status}))
    node.destroy_node()
    rclpy.try_shutdown()


def _publish(node: Any, given: dict[str, Any]) -> list[int]:
    """Returns the stamps of the images that count, ns."""
    serialize = serialize_jpeg if given['transport'] == 'compressed' else serialize_image
    images = (
        Image(lights_above_runway(given['width'], given['height'], index), 'mono8')
        for index in range(FRAMES)
    )
    header, encoding = cdr_header(0, 'nose'), given['encoding']
    messages = cycle([serialize(as_encoding(image, encoding), header) for image in images])
    publisher = node.create_publisher(*_STREAMS[given['transport']], QoSProfile(depth=10))
    end = time.monotonic() + 20.0
    while publisher.get_subscription_count() < given['subscribers'] and time.monotonic() < end:
        time.sleep(0.05)
    time.sleep(0.5)
    period = 1.0 / given['hz']
    stamps: list[int] = []
    due = time.monotonic()
    for index in range(round((given['seconds'] + WARM_UP) / period)):
        stamp_ns = time.time_ns()
        publisher.publish(_stamped(next(messages), stamp_ns))
        if index * period >= WARM_UP:
            if not stamps:
                print('begin', flush=True)
            stamps.append(stamp_ns)
        due += period
        time.sleep(max(due - time.monotonic(), 0.0))
    return stamps


def _keep_arrival(answers: dict[int, int], message: bytes) -> None:
    answers[stamp_ns_in(message)] = time.time_ns()  # taken before the stamp is read


def _keep_status(newest: dict[str, dict[str, str]], message: DiagnosticArray) -> None:
    for status in message.status:
        newest[status.name.strip('/')] = {pair.key: pair.value for pair in status.values}


if __name__ == '__main__':
    {'camera': camera, 'floor': floor}[sys.argv[1]](sys.argv[2])

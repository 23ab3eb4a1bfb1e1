"""What a flight brings: odd streams, restarts, storms. Every frame is answered or counted."""

import os
import random
import subprocess
import sys
import time

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, PointCloud2
from sensor_msgs.msg import Image as RosImage
from support.graph import CLEAN, ROOT
from support.live_stream import KEEP_EVERYTHING, START_NS, Stream
from support.marker_scenes import draw, tanker_at

from mvuav_ros.messages.cdr import cdr_header, view_points
from mvuav_ros.messages.images import serialize_image
from mvuav_ros.vision.image import ENCODINGS, Image

BOTH = ('marker_tracker', 'runway_detector')
KILLS = int(os.environ.get('MVUAV_KILLS', '4'))
FIRST_FRAMES = 10
"""Within which the markers are named again."""


def any_image(encoding: str, width: int, height: int) -> Image:
    layout = ENCODINGS[encoding]
    shape = (height, width) if layout.channels == 1 else (height, width, layout.channels)
    high = np.iinfo(layout.dtype).max + 1
    pixels = np.random.default_rng(width * height).integers(0, high, shape).astype(layout.dtype)
    return Image(pixels, encoding)


def test_sizes_and_encodings_that_change_with_every_frame(graph):
    stream = Stream(graph, *BOTH, **KEEP_EVERYTHING)
    sizes = [(1, 1), (2, 2), (640, 480), (3, 200), (200, 3), (32, 24), (131, 131)]
    sent = 0
    for encoding in ENCODINGS:
        for width, height in sizes:
            if ENCODINGS[encoding].chroma_below:
                # Its colours are half a frame more of rows: see test_image_decoding.
                continue
            if 'yuv' in encoding or 'uyvy' in encoding or 'yuyv' in encoding:
                width += width % 2
            image = any_image(encoding, width, height)
            header = cdr_header(stream.next_stamp(), 'nose')
            stream.publisher.publish(serialize_image(image, header))
            sent += 1
            graph.spin(0.002)
    graph.until(
        lambda: all(
            int(values['frames_processed']) + int(values['frames_rejected']) == sent
            for values in (graph.diagnostics(name) for name in BOTH)
        ),
        'every frame to be answered or refused',
    )
    for name in BOTH:
        values = graph.diagnostics(name)
        # A mosaic has no colours below two rows and columns; everything else is answered.
        assert values.get('rejected_internal_error') is None, values['last_rejection']
        assert int(values['frames_processed']) == len(stream.answers[name]) >= sent * 0.9
    before = stream.counts()['marker_tracker']
    stream.play(0.5)
    stream.until_answered(before + 30)
    assert stream.states() == [1] * 5


def test_stamps_that_repeat_stand_still_and_jump(graph):
    stream = Stream(graph, 'marker_tracker', **KEEP_EVERYTHING)
    second = 1_000_000_000
    first = [START_NS + i * second // 60 for i in range(20)]
    repeated = [stamp for stamp in first[10:] for _ in range(2)]
    still = [first[-1]] * 10
    forward = [first[-1] + 3600 * second + i * second // 60 for i in range(10)]
    back = [START_NS - 10 * second + i * second // 60 for i in range(10)]
    ancient = [-(2**31) * second, 0, second, (2**31 - 1) * second + 999_999_999]
    stamps = first[:10] + repeated + still + forward + back + ancient
    for stamp_ns in stamps:
        message = serialize_image(Image(draw(tanker_at()), 'mono8'), cdr_header(stamp_ns, ''))
        stream.publisher.publish(message)
        graph.spin(0.005)
    answered = sum(a != b for a, b in zip(stamps, [None, *stamps], strict=False))
    stream.until_answered(answered)
    graph.spin(0.3)
    answers = stream.answers['marker_tracker']
    told = [a.header.stamp.sec * second + a.header.stamp.nanosec for a in answers]
    expected = [s for s, last in zip(stamps, [None, *stamps], strict=False) if s != last]
    # A stamp of 0 is none: then it is the time of sending.
    sent = told.pop(expected.index(0))
    expected.remove(0)
    assert abs(sent - time.time_ns()) < 3600 * second
    assert told == expected
    values = graph.diagnostics('marker_tracker')
    assert values['rejected_duplicate_stamp'] == str(len(stamps) - answered) == '20'
    assert values['stamp_jumps_back'] == '3'
    assert values['stamp_jumps_forward'] >= '1'
    assert values.get('rejected_internal_error') is None


def test_nan_and_nonsense(graph):
    stream = Stream(graph, *BOTH, **KEEP_EVERYTHING)
    client = graph.probe.create_client(SetParameters, '/marker_tracker/set_parameters')
    graph.until(client.service_is_ready, 'the parameter service')
    # rclpy itself stumbles over this one, while it spins.
    impossible = ParameterMessage(name='threshold', value=ParameterValue(type=77))
    for _ in range(20):
        client.call_async(SetParameters.Request(parameters=[impossible]))
        graph.spin(0.03)
    for node, names in (
        ('marker_tracker', ['threshold', 'lost_timeout']),
        ('runway_detector', ['rho_resolution', 'edge_threshold', 'theta_error_threshold_deg']),
    ):
        for name in names:
            before = graph.get_parameter(node, name)
            for value in (float('nan'), float('inf'), float('-inf')):
                assert not graph.set_parameter(node, name, value).successful
            assert graph.get_parameter(node, name) == before
    infos = graph.probe.create_publisher(CameraInfo, '/camera_info', 10)
    nan = float('nan')
    bad = CameraInfo(width=640, height=480, k=[nan] * 9, d=[nan] * 5, r=[nan] * 9, p=[nan] * 12)
    stream.play(0.5, beside=lambda: infos.publish(bad))
    before = stream.counts()
    stream.play(0.5)
    graph.until(lambda: all(stream.counts()[name] > before[name] + 20 for name in BOTH), 'answers')
    assert stream.states() == [1] * 5
    stream.check_alive()


def test_a_storm_of_parameters(graph):
    """As many as the node takes: more than a thousand in a second where there is nothing else."""
    stream = Stream(graph, 'marker_tracker', **KEEP_EVERYTHING)
    client = graph.probe.create_client(SetParameters, '/marker_tracker/set_parameters')
    graph.until(client.service_is_ready, 'the parameter service')
    outstanding, accepted = [], 0

    def storm() -> None:
        nonlocal accepted
        for future in [f for f in outstanding if f.done()]:
            outstanding.remove(future)
            results = future.result().results
            assert all(result.successful for result in results)
            accepted += len(results)
        while len(outstanding) < 6:
            values = {
                'threshold': random.uniform(0.5, 0.7),
                'search_radius': random.randint(8, 12),
                'grouping_distance': random.randint(10, 15),
                'min_area': random.randint(1, 3),
                'lost_timeout': 0.5,
            }
            parameters = [Parameter(n, value=v).to_parameter_msg() for n, v in values.items()]
            outstanding.append(client.call_async(SetParameters.Request(parameters=parameters)))

    begun = time.monotonic()
    sent = stream.play(4.0, beside=storm)
    stream.until_answered(sent)
    graph.until(lambda: storm() or accepted >= 200, 'answers to the storm')
    graph.until(lambda: all(future.done() for future in outstanding), 'the last answers')
    print(f'{accepted / (time.monotonic() - begun):.0f} parameters set per second')
    assert all(list(view_points(a)['state']) == [1] * 5 for a in stream.answers['marker_tracker'])
    assert graph.set_parameter('marker_tracker', 'threshold', 0.65).successful
    assert graph.get_parameter('marker_tracker', 'threshold') == 0.65


def test_two_publishers_and_their_end(graph):
    stream = Stream(graph, 'marker_tracker', **KEEP_EVERYTHING)
    other = graph.probe.create_publisher(RosImage, '/image_raw', QoSProfile(depth=100))
    graph.until(lambda: other.get_subscription_count() == 1, 'the node')

    def beside() -> None:
        pixels = draw(tanker_at(300, 200))
        header = cdr_header(stream.next_stamp(), 'b')
        other.publish(serialize_image(Image(pixels, 'mono8'), header))

    sent = 2 * stream.play(1.5, beside=beside)
    stream.until_answered(sent)
    values = graph.diagnostics('marker_tracker')
    assert '2 publishers on /image_raw' in values['message'] and values['level'] == 1
    assert values['frames_missing'] == '0'
    graph.probe.destroy_publisher(other)
    stream.play(1.5)
    assert '2 publishers' not in graph.diagnostics('marker_tracker')['message']


def test_subscribers_come_and_go(graph):
    stream = Stream(graph, *BOTH, **KEEP_EVERYTHING)
    topics = [
        ('/marker_tracker/markers', PointCloud2),
        ('/marker_tracker/debug_image', RosImage),
        ('/runway_detector/debug/overlay', RosImage),
        ('/runway_detector/debug/hough', RosImage),
        ('/runway_detector/corrections', DiagnosticArray),
    ]
    taken, current = [], []

    def churn() -> None:
        for subscription in current:
            graph.probe.destroy_subscription(subscription)
        current[:] = [
            graph.probe.create_subscription(kind, topic, taken.append, 10)
            for topic, kind in random.sample(topics, 2)
        ]

    sent = 0
    for _ in range(30):
        churn()
        sent += stream.play(0.1, hz=30)
    stream.until_answered(sent)
    assert stream.counts() == dict.fromkeys(BOTH, sent)
    for name in BOTH:
        assert graph.diagnostics(name)['frames_rejected'] == '0'


def test_simulated_time_that_loops_and_stands_still(graph):
    clock = graph.probe.create_publisher(Clock, '/clock', 10)
    stream = Stream(graph, 'marker_tracker', use_sim_time=True, **KEEP_EVERYTHING)
    ticks = 0

    def tick() -> None:
        nonlocal ticks
        ticks += 1
        if ticks < 90:
            message = Clock()
            # Twice around, then it stands.
            message.clock.sec, message.clock.nanosec = 100 + ticks % 45, 0
            clock.publish(message)

    sent = stream.play(3.0, hz=50, beside=tick)
    stream.until_answered(sent)
    values = graph.diagnostics('marker_tracker')
    assert values['frames_processed'] == str(sent)
    stamps = {m.header.stamp.sec for m in graph.received['/diagnostics']}
    assert stamps and all(90 <= stamp <= 150 for stamp in stamps)


CAMERA = """
import os, signal, struct, sys, time
import rclpy
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image as RosImage
sys.path.insert(0, 'test')
from support.marker_scenes import draw, tanker_at
from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.images import serialize_image
from mvuav_ros.nodes.running import prepare_transport
from mvuav_ros.vision.image import Image

def publish():
    prepare_transport()
    rclpy.init()
    node = rclpy.create_node('camera')
    publisher = node.create_publisher(RosImage, 'image_raw', QoSProfile(depth=10))
    image = Image(draw(tanker_at()), 'mono8')
    while True:
        publisher.publish(serialize_image(image, cdr_header(time.time_ns(), 'nose')))
        time.sleep(1 / 60)

# Everything is imported once; each camera is a copy of this process.
for line in sys.stdin:
    child = os.fork()
    if child == 0:
        publish()
    print(child, flush=True)
    sys.stdin.readline()
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    print('killed', flush=True)
"""


def test_a_publisher_that_is_killed_and_restarted(graph):
    stream = Stream(graph, 'marker_tracker')
    graph.probe.destroy_publisher(stream.publisher)
    cameras = subprocess.Popen(
        [sys.executable, '-c', CAMERA],
        cwd=ROOT,
        env={**CLEAN, 'ROS_DOMAIN_ID': str(graph.domain_id)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    answers = stream.answers['marker_tracker']
    try:
        for _ in range(KILLS):
            answers.clear()
            print(file=cameras.stdin, flush=True)
            cameras.stdout.readline()
            graph.until(lambda: len(answers) > 0, 'the first answer')
            graph.until(lambda: stream.states() == [1] * 5, 'five markers')
            states = [list(view_points(answer)['state']) for answer in answers]
            # Of the new camera's images that got through.
            assert states.index([1] * 5) < FIRST_FRAMES
            graph.spin(random.uniform(0.1, 0.4))
            print(file=cameras.stdin, flush=True)
            assert cameras.stdout.readline().strip() == 'killed'
    finally:
        cameras.stdin.close()
        cameras.wait(timeout=120)
    stream.check_alive()
    assert graph.diagnostics('marker_tracker')['frames_rejected'] == '0'

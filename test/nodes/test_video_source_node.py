"""video_source as a process on real DDS."""

import subprocess
import sys
import time
from threading import Event
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_srvs.srv import SetBool, Trigger
from support.graph import ROOT, image_message
from support.marker_scenes import draw, tanker_at

from mvuav_ros.messages.images import BadFrame, Frame, decode_compressed_image, decode_image
from mvuav_ros.messages.sensors import stamp_ns_of
from mvuav_ros.nodes import video_source_node
from mvuav_ros.nodes.diagnostics import SourceStatus
from mvuav_ros.nodes.publishing import as_encoding
from mvuav_ros.nodes.video_source_node import Pace, SourcePlayer
from mvuav_ros.parameters.video_source import VideoSourceParameters
from mvuav_ros.recordings.account import Account
from mvuav_ros.recordings.writing import RecordingWriter
from mvuav_ros.sources.opening import open_source
from mvuav_ros.vision.image import Image as OwnImage

NODE = 'video_source'


@pytest.fixture
def folder(tmp_path):
    for index in range(12):
        cv2.imwrite(str(tmp_path / f'frame{index}.png'), np.full((48, 64, 3), 20 * index, np.uint8))
    return tmp_path


@pytest.fixture
def bag(tmp_path):
    path = tmp_path / 'flight.mcap'
    with RecordingWriter(path) as writer:
        for index in range(10):
            message = image_message(draw(tanker_at()), index, hz=20.0, frame_id='boom_camera')
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            writer.write('/cam', 'sensor_msgs/msg/Image', stamp, serialize_message(message))
    return path


def stamps(messages):
    return [m.header.stamp.sec + m.header.stamp.nanosec * 1e-9 for m in messages]


def play(graph, source, topic='/image_raw', kind=Image, **parameters):
    """Listen first, then start the source: it waits for us."""
    messages = graph.received[topic]
    graph.probe.create_subscription(kind, topic, messages.append, 100)
    graph.start(NODE, source=source, **parameters)
    return messages


def test_a_folder_of_images(graph, folder):
    (folder / 'frame5.png').write_bytes(b'not an image')
    infos = graph.received['/camera_info']
    graph.probe.create_subscription(CameraInfo, '/camera_info', infos.append, 100)
    images = play(graph, folder, rate=100.0, frame_id='nose')
    graph.until(lambda: len(images) == 11 and len(infos) == 11, '11 images')
    values = [decode_image(image).pixels[0, 0, 0] for image in images]
    assert values == [20 * i for i in range(12) if i != 5]
    assert images[0].encoding == 'bgr8'
    replayed = [f.stamp_ns for f in open_source(str(folder)).frames() if isinstance(f, Frame)]
    assert [stamp_ns_of(image.header) for image in images] == replayed
    assert [info.header for info in infos] == [image.header for image in images]
    assert images[0].header.frame_id == 'nose'
    assert (infos[0].width, infos[0].height, infos[0].k[0]) == (64, 48, 0.0)


def test_a_bag_is_paced_by_its_stamps(graph, bag):
    images = play(graph, bag, stamp='now')
    graph.until(lambda: len(images) == 10, '10 images')
    assert images[0].header.frame_id == 'boom_camera'
    np.testing.assert_array_equal(decode_image(images[0]).pixels, draw(tanker_at()))
    # Nine gaps of 0.05 s, of which a busy machine may shorten the first ones.
    published = stamps(images)
    assert published[-1] - published[0] > 0.2


def test_loop_pause_and_restart(graph, bag):
    images = play(graph, bag, rate=200.0, loop=True)
    graph.until(lambda: len(images) > 25, 'the bag to loop')
    assert graph.call(SetBool, f'/{NODE}/pause', SetBool.Request(data=True)).success
    graph.until_silent(images)
    count = len(images)
    graph.spin(0.3)
    assert len(images) == count
    assert graph.set_parameter(NODE, 'loop', False).successful
    assert graph.call(SetBool, f'/{NODE}/pause', SetBool.Request(data=False)).success
    graph.until(lambda: graph.diagnostics(NODE)['state'] == 'ended', 'the end')
    graph.until_silent(images)
    images.clear()
    assert graph.call(Trigger, f'/{NODE}/restart', Trigger.Request()).success
    graph.until(lambda: len(images) == 10, 'the bag again')


def test_restart_in_the_middle(graph, bag):
    images = play(graph, bag, rate=3.0)
    graph.until(lambda: len(images) == 3, '3 images')
    assert graph.call(Trigger, f'/{NODE}/restart', Trigger.Request()).success
    begun = stamps(images)[0]
    graph.until(lambda: begun in stamps(images[3:]), 'the first image again')
    again = stamps(images).index(begun, 3)
    # It had not come to the end by itself.
    assert again < 10
    graph.until(lambda: len(images) >= again + 5, '5 more images')
    assert stamps(images[again:])[:3] == stamps(images)[:3]


def test_encoding_gamma_and_stamp(graph, folder):
    images = play(graph, folder, rate=50.0, encoding='mono8', gamma=2, stamp='now')
    graph.until(lambda: len(images) == 12, '12 images')
    assert images[6].encoding == 'mono8'
    assert decode_image(images[6]).pixels[0, 0] == round((120 / 255) ** 2 * 255)
    assert abs(stamps(images)[-1] - time.time()) < 30


def test_other_encodings():
    bgr = np.array([[[1, 2, 3]]], np.uint8)
    assert as_encoding(OwnImage(bgr, 'bgr8'), 'rgb8').pixels.tolist() == [[[3, 2, 1]]]
    assert as_encoding(OwnImage(bgr[:, :, ::-1], 'rgb8'), 'bgr8').pixels.tolist() == bgr.tolist()
    deep = OwnImage(np.array([[0x1234]], np.uint16), 'mono16')
    assert as_encoding(deep, 'mono8').pixels.tolist() == [[0x12]]
    assert as_encoding(deep, 'source') is deep


def test_compressed_images(graph, bag):
    images = play(graph, bag, '/image_raw/compressed', CompressedImage)
    graph.until(lambda: len(images) == 10, '10 images')
    difference = decode_compressed_image(images[0]).pixels.astype(int) - draw(tanker_at())
    assert np.abs(difference).mean() < 2


@pytest.mark.parametrize(('topic', 'focal_length'), [('/nose/image', 50), ('/nose/image_rect', 60)])
def test_calibration(graph, tmp_path, topic, focal_length):
    bag = tmp_path / 'nose.mcap'
    with RecordingWriter(bag) as writer:
        message = serialize_message(image_message(np.zeros((48, 64), np.uint8), 0))
        writer.write(topic, 'sensor_msgs/msg/Image', 0, message)
        # What is given counts, not what was recorded.
        other = CameraInfo(width=64, height=48, k=[90.0, 0, 32.0, 0, 90.0, 24.0, 0, 0, 1.0])
        kind = 'sensor_msgs/msg/CameraInfo'
        writer.write('/nose/camera_info', kind, 0, serialize_message(other))
    calibration = tmp_path / 'nose.yaml'
    calibration.write_text(
        'image_width: 64\nimage_height: 48\ncamera_name: nose\n'
        'camera_matrix: {rows: 3, cols: 3, data: [50, 0, 32, 0, 51, 24, 0, 0, 1]}\n'
        'distortion_model: plumb_bob\n'
        'distortion_coefficients: {rows: 1, cols: 5, data: [0.1, 0, 0, 0, 0]}\n'
        'rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}\n'
        'projection_matrix: {rows: 3, cols: 4, data: [60, 0, 32, 0, 0, 61, 24, 0, 0, 0, 1, 0]}\n'
    )
    infos = play(
        graph,
        bag,
        '/camera_info',
        CameraInfo,
        camera_info_url=f'file://{calibration}',
        wait_for_subscribers=0,
        loop=True,
    )
    graph.until(lambda: len(infos) > 1, 'calibrations')
    assert list(infos[0].k) == [focal_length, 0, 32, 0, focal_length + 1, 24, 0, 0, 1]
    assert infos[0].distortion_model == 'plumb_bob'


@pytest.mark.parametrize(
    ('parameters', 'words'),
    [
        ({'source': '/nowhere/flight.mcap'}, 'no such file'),
        ({'source': 'sim:zeppelin'}, 'sim:tanker and sim:runway'),
        ({'source': __file__}, 'not a video'),
        ({'source': '.', 'camera_info_url': '/nowhere.yaml'}, 'no images and no bag'),
        ({'source': '0', 'camera_info_url': '/nowhere.yaml'}, 'No such file'),
        ({'source': '0', 'rate': -1.0}, 'rate: must be 0 to 10000'),
    ],
)
def test_a_bad_start_is_one_clear_line(graph, parameters, words):
    process = graph.spawn(NODE, **parameters)
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 2
    # FFmpeg's own words come before ours.
    assert words in output.strip().splitlines()[-1]
    assert 'Traceback' not in output


def test_a_missing_camera_is_waited_for(graph):
    process = graph.start(NODE, source=77)
    graph.until(lambda: graph.diagnostics(NODE)['state'] == 'retrying', 'another try')
    said = graph.diagnostics(NODE)
    assert said['level'] == 2 and 'camera 77' in said['message']
    assert process.poll() is None
    process.send_signal(2)
    output, _ = process.communicate(timeout=120)
    assert 'camera 77 cannot be opened' in output
    assert 'VIDEOIO' not in output
    assert 'trying again' in output
    assert process.returncode == 0


BREAKING = """
import sys
from mvuav_ros.nodes import running, video_source_node
def broken(self, frame): raise ZeroDivisionError('what nobody thought of')
video_source_node.VideoSource.publish = broken
sys.argv[1:] = ['--ros-args', '-p', 'wait_for_subscribers:=0', '-p', f'source:={sys.argv[1]}']
running.video_source()
"""


def test_a_source_that_breaks_ends_with_a_line_and_a_status(bag):
    command = [sys.executable, '-c', BREAKING, str(bag)]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert run.returncode == 1, run.stderr
    assert 'flight.mcap /cam: ZeroDivisionError: what nobody thought of' in run.stderr
    assert 'Traceback' not in run.stderr


def test_a_source_without_a_frame_ends_although_it_loops(graph, tmp_path):
    for number in range(3):
        (tmp_path / f'{number}.png').write_bytes(b'not an image')
    graph.start(NODE, source=tmp_path, loop=True, wait_for_subscribers=0)
    graph.until(lambda: graph.diagnostics(NODE)['state'] == 'ended', 'its end')
    assert graph.diagnostics(NODE)['troubles'] == '3'
    # From the start again where it is asked for, and once.
    graph.call(Trigger, f'/{NODE}/restart', Trigger.Request())
    graph.until(lambda: graph.diagnostics(NODE)['troubles'] == '6', 'the restart')
    graph.spin(1.0)
    assert graph.diagnostics(NODE)['troubles'] == '6'


class Logged:
    """A node that keeps what is logged, throttled and not."""

    def __init__(self):
        self.status, self.context = SourceStatus('fake'), None
        self.current = VideoSourceParameters(wait_for_subscribers=0)
        self.throttled, self.lines = [], []

    def get_logger(self):
        return self

    def info(self, _text):
        pass

    def warning(self, text, throttle_duration_sec=None):
        (self.lines if throttle_duration_sec is None else self.throttled).append(text)


class Damaged:
    """A recording of one broken frame, whose account has losses."""

    name, live, count, rate = 'fake', False, None, None

    def __init__(self):
        self.account = Account('fake')
        for number in range(3):
            self.account.lose('file', number, f'loss {number}', 1)

    def frames(self):
        return iter([BadFrame(0, 'torn')])

    def close(self):
        pass


def test_every_loss_of_a_recording_is_logged():
    node = Logged()
    player = SourcePlayer(node, Damaged())
    player.start()
    while node.status.state != 'ended':
        time.sleep(0.01)
    player.stop()
    assert node.throttled == ['frame skipped: torn']
    (line,) = node.lines
    assert all(f'loss {number}' in line for number in range(3))


def test_a_restart_is_seen_after_its_interrupt():
    """Else the thread would clear the interrupt of the pass before, and keep the late one."""
    player = SourcePlayer(Logged(), Damaged())
    seen = []
    player._interrupt.set = lambda: seen.append(player._rewind)
    player.restart()
    assert seen == [False] and player._rewind


def test_a_restart_in_the_midst_of_a_new_pass_is_not_lost():
    """Its interrupt was kept without the rewind: that pass ran as fast as it could be read."""
    player = SourcePlayer(Logged(), Damaged())

    clear, passes = player._interrupt.clear, []

    def between():
        clear()
        player.restart()

    def play():
        passes.append((player._rewind, player._interrupt.is_set()))
        player._stop.set()

    player._interrupt.clear, player._play = between, play
    player._run()
    assert passes == [(True, True)]


@pytest.fixture
def clock(monkeypatch):
    """A clock that only waiting moves: its time, s, and an event whose waits do so."""
    clock, event = SimpleNamespace(now=0.0), Event()

    def wait(seconds):
        clock.now += seconds

    event.wait, clock.event = wait, event
    monkeypatch.setattr(video_source_node.time, 'monotonic', lambda: clock.now)
    return clock


def test_a_pause_is_no_delay_to_be_caught_up_with(clock):
    pace = Pace(lambda: 0.0)
    pace.wait(0, clock.event)
    pace.wait(10_000_000_000, clock.event)
    assert clock.now == pytest.approx(5.0, abs=0.1)
    pace.resume()
    pace.wait(20_000_000_000, clock.event)
    assert clock.now == pytest.approx(5.0, abs=0.1)
    pace.wait(21_000_000_000, clock.event)
    assert clock.now > 5.5


def test_a_frame_that_is_late_is_caught_up_with_and_time_that_runs_back_is_no_hurry(clock):
    pace, shown = Pace(lambda: 0.0), []
    # The stamp of each frame, and how long the one before it took, s.
    for stamp, took in ((0.0, 0.0), (0.1, 0.3), (0.5, 0.0), (0.6, 2.0), (0.7, 0.0), (0.2, 0.0)):
        clock.now += took
        pace.wait(round(stamp * 1e9), clock.event)
        shown.append(clock.now)
    pace.wait(300_000_000, clock.event)
    # At 2.5 s it is too late by far: from there on it goes as it is.
    assert [*shown, clock.now] == pytest.approx([0.0, 0.3, 0.5, 2.5, 2.6, 2.6, 2.7])
    pace.wait(100_300_000_000, clock.event)
    pace.wait_for_end(clock.event)
    assert clock.now == pytest.approx(2.7 + 5.0 + 5.0)


def test_another_rate_counts_while_a_frame_is_waited_for(clock):
    pace = Pace(lambda: 0.01 if clock.now < 3.0 else 10.0)
    pace.wait(0, clock.event)
    pace.wait(1, clock.event)
    assert clock.now == pytest.approx(3.0, abs=0.5)
    pace.wait(2, clock.event)
    assert clock.now == pytest.approx(3.1, abs=0.5)


def played(node, source):
    """A player for this thread, and the stamps that it sends."""
    player, sent = SourcePlayer(node, source), []
    node.publish = lambda frame: sent.append(frame.stamp_ns)
    return player, sent


class Two(Damaged):
    """A recording of two frames, 1 s apart."""

    def __init__(self):
        self.account = Account('fake')

    def frames(self):
        return iter([Frame(0, '', None), Frame(1_000_000_000, '', None)])


def test_no_frame_comes_after_a_pause_although_it_is_waited_for(clock):
    source, go_on, times = Two(), [], []
    source.frames = lambda: iter([Frame(n * 1_000_000_000, '', None) for n in range(3)])
    player, sent = played(Logged(), source)
    player._node.publish = lambda frame: (sent.append(frame.stamp_ns), times.append(clock.now))

    def wait(seconds):
        clock.now += seconds
        player.paused = not go_on

    def resumed():
        go_on.append((clock.now, list(sent)))
        clock.now += 0.5
        player.paused = False

    player._interrupt, player._running.wait = clock.event, resumed
    player._at_end = lambda *_: None
    clock.event.wait = wait
    player._play()
    assert [seen for _, seen in go_on] == [[0]]
    assert sent == [0, 1_000_000_000, 2_000_000_000]
    # The pause lies between the frames as it was.
    assert times == pytest.approx([0.0, 1.5, 2.5])


def test_the_last_frame_of_a_pass_lasts_like_the_one_before_it(clock):
    """A single image was published as fast as the machine could, whatever the rate."""
    node = Logged()
    node.current = VideoSourceParameters(loop=True)
    player, sent = played(node, Two())
    player._interrupt = clock.event
    player._play()
    assert (sent, clock.now) == ([0, 1_000_000_000], pytest.approx(2.0))
    pace = Pace(lambda: 0.0, spacing=0.04)
    for _ in range(2):
        clock.now = 0.0
        pace.resume()
        pace.wait(0, clock.event)
        pace.wait_for_end(clock.event)
        assert clock.now == pytest.approx(0.04)


def test_what_a_camera_sees_during_a_pause_is_left():
    """It was sent when the camera went on, with the stamp of the pause."""
    player, sent = played(Logged(), camera := Two())

    def frames():
        yield Frame(0, '', None)
        player.paused = True
        yield Frame(1, '', None)
        player.paused = False
        yield Frame(2, '', None)

    camera.live, camera.frames = True, frames
    player._at_end = lambda *_: None
    player._running.wait = player._running.set  # in place of waiting for ever
    player._play()
    assert sent == [0, 2]

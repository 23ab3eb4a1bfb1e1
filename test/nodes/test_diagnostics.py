"""What /diagnostics says, and the small parts that it is made of."""

import threading
from collections import deque
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest
from std_srvs.srv import SetBool
from support.live_stream import KEEP_EVERYTHING, Stream

from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.images import Frame, serialize_image
from mvuav_ros.messages.sensors import stamp_ns_of
from mvuav_ros.nodes import diagnostics
from mvuav_ros.nodes.diagnostics import (
    DetectorStatus,
    FrameStatistics,
    FrameTimes,
    SourceStatus,
    StampMonitor,
    explain_no_images,
)
from mvuav_ros.nodes.image_input import (
    Backlog,
    ImageInput,
    InputEvents,
    InputState,
    IntraProcessInput,
)
from mvuav_ros.vision.image import Image


def test_where_the_time_goes(graph):
    stream = Stream(graph, 'marker_tracker', **KEEP_EVERYTHING)
    assert graph.diagnostics('marker_tracker')['level'] == 3
    stream.play(2.0)
    values = graph.diagnostics('marker_tracker')
    assert values['message'] == 'running; no pose: nothing publishes /camera_info'
    assert values['level'] == 0
    stages = [float(values[f'{s}_p50_ms']) for s in ('decode', 'process', 'publish')]
    assert all(stage > 0 for stage in stages)
    assert float(values['latency_p50_ms']) >= max(stages)
    assert float(values['latency_p99_ms']) >= float(values['latency_p50_ms'])
    assert 0 < float(values['transport_p50_ms']) < 60_000
    assert float(values['stamp_rate_hz']) == pytest.approx(60.0, abs=0.2)
    assert values['image'] == '640x480 mono8'
    assert values['image_publishers'] == '/probe'


def test_frames_that_the_camera_leaves_out_are_seen_in_the_stamps(graph):
    stream = Stream(graph, 'marker_tracker', **KEEP_EVERYTHING)
    stream.play(1.0)
    for _ in range(5):
        stream.next_stamp()
    stream.play(1.2)
    values = graph.diagnostics('marker_tracker')
    assert values['frames_left_out_by_stamps'] == '5'
    assert values['frames_missing'] == '0'
    assert 'gaps in the stamps: 5 images' in values['message'] and values['level'] == 1


def test_a_node_that_is_too_slow_shows_the_newest_frame_and_counts_the_rest(graph):
    """A frame of noise searched for the finest lines takes longer than the few ms between two.

    Each frame has noise of its own, as edges that stay are not counted again. The first ones are
    waited for: until two came one after the other nobody knows how many are missing in a gap. It
    is sent until the node has answered often enough to know that it is too slow, however slow.
    """
    slow = {'start_row': 0, 'end_row': 0, 'rho_resolution': 0.5, 'theta_resolution_deg': 0.1}
    stream = Stream(graph, 'runway_detector', **slow)
    noise = np.random.default_rng(0).integers(0, 255, (8, 768, 1024), np.uint8)
    sent, stamp_ns, answers = 0, 0, stream.answers['runway_detector']

    def is_answered():
        return answers and stamp_ns_of(answers[-1].header) == stamp_ns

    is_last = False
    while not is_last:
        stamp_ns = stream.next_stamp(100.0)
        image = serialize_image(Image(noise[sent % 8], 'mono8'), cdr_header(stamp_ns, 'nose'))
        stream.publisher.publish(image)
        sent += 1
        assert sent < 50_000, f'{len(answers)} frames were answered'
        is_last = sent >= 200 and len(answers) >= 40
        if sent <= 3 or is_last:
            graph.until(is_answered, 'the newest frame')
        else:
            graph.spin(0.002)
    graph.spin(1.0)
    values = graph.diagnostics('runway_detector')
    answered, gone = int(values['frames_processed']), int(values['frames_missing'])
    skipped = int(values['frames_skipped'])
    assert 0 < answered < 0.9 * sent
    assert skipped > 0
    # Nothing disappears uncounted; the last few may never have been followed by another.
    assert sent - 5 <= answered + skipped + gone <= sent
    assert 'too slow for the camera' in values['message'] and values['level'] == 1
    # Never more than the queue and the frame in work behind.
    assert stamp_ns_of(stream.answers['runway_detector'][-1].header) == stamp_ns


def test_a_node_alone(graph):
    graph.start('marker_tracker', opencv_threads=2)
    values = graph.diagnostics('marker_tracker')
    assert values['level'] == 3
    assert values['message'] == 'no images: nothing publishes /image_raw'
    for value in (0, 1, 64):
        assert graph.set_parameter('marker_tracker', 'opencv_threads', value).successful
    for value in (65, -1):
        assert not graph.set_parameter('marker_tracker', 'opencv_threads', value).successful


def test_what_was_before_an_activation_is_not_of_the_last_seconds():
    statistics = FrameStatistics()
    statistics.arrived()
    frame = Frame(0, 'camera', Image(np.zeros((2, 2), np.uint8), 'mono8'))
    statistics.processed_one(frame, FrameTimes(0.0, 0.0, 0.0, 0.0, 0.0))
    statistics.reject('bad image', 'torn')
    statistics.restart()
    statistics.arrived()
    assert statistics.problems() == []
    values = statistics.values()
    assert (values['output_rate_hz'], values['frames_processed']) == ('0.0', '1')
    assert values['rejected_bad_image'] == '1'


def test_a_hiccup_is_worked_off_and_a_slow_node_skips():
    backlog = Backlog()
    assert not any(backlog.skips(n) for n in (1, 1, 5, 3, 2, 1, 4, 2, 1, 2, 2, 1))
    backlog = Backlog()
    skipped = [backlog.skips(n) for n in (1, 2, 4, 5, 2, 2, 1, 2)]
    assert skipped == [False, False, False, True, True, True, False, True]
    # Fast enough again.
    assert not any(backlog.skips(n) for n in (1, 1, 1, 1, 1, 2, 1))


def test_stamps():
    watch = StampMonitor()
    stamps = [i * 33_333_333 for i in range(40)]
    for stamp in stamps[:20] + stamps[22:] + stamps:
        watch.follow(stamp)
    assert watch.frames_left_out == 2
    assert watch.spacing_ns == pytest.approx(33_333_333, abs=10)
    watch.follow(stamps[-1] + 6_000_000_000)
    assert (watch.frames_left_out, watch.jumps_forward) == (2, 1)


def test_irregular_stamps_are_no_gaps():
    watch = StampMonitor()
    stamp = 0
    for index in range(200):
        stamp += 33_000_000 + (index % 3) * 5_000_000
        watch.follow(stamp)
    assert watch.frames_left_out == 0


def test_the_first_few_stamps_say_nothing_of_gaps_and_those_that_run_back_nothing_at_all():
    watch = StampMonitor()
    for stamp in (0, 100, 400, 500, 900):
        watch.follow(stamp)
    assert (watch.frames_left_out, watch.spacing_ns) == (0, 0)
    for stamp in range(800, 0, -100):
        watch.follow(stamp)
    assert watch.spacing_ns == 0


def test_problems_are_those_of_the_last_seconds():
    statistics, events = FrameStatistics(), InputEvents()
    processor = SimpleNamespace(resets=0, calibration='none', status='', frames_problem='')
    status, images = DetectorStatus(statistics, processor), InputState('/image_raw', [], events)
    statistics.arrived()

    def said():
        return status.report('node', images, []).message

    assert said() == 'running'
    events.lost = events.missing = 7
    problem = said()
    assert problem.startswith('7 images lost') and 'docs/transport.md' in problem
    events.missing += 1
    assert 'too slow for the camera: 1 image skipped;' in said()
    for _ in range(6):
        last = said()
    assert last == 'running'
    statistics.stamps.frames_left_out = 3
    assert said().startswith('gaps in the stamps: 3 images missing')
    # Those that were lost on their way are no fault of the camera.
    events.lost += 3
    events.missing += 3
    assert 'gaps' not in said()


@pytest.mark.parametrize('total', [3, 2**64 - 2**31 + 3])
def test_a_middleware_that_begins_to_count_at_the_least_number_has_no_losses_by_that(total):
    there = MagicMock(_asked=None, _lost_before=2, _incompatible=None, _events=InputEvents())
    there._lost.take_event.return_value.total_count = total
    there._better.return_value = None
    assert ImageInput.poll(there).events.lost == 5


def test_what_was_sent_before_the_first_image_is_not_missing():
    publishers = MagicMock(return_value=1)
    there = SimpleNamespace(_last_sequence=0, _is_first=True, _is_one=True, _events=InputEvents())
    there._subscription = SimpleNamespace(get_publisher_count=publishers)
    assert [ImageInput._follow(there, number) for number in (57, 58, 61)] == [True, False, True]
    assert there._events.missing == 2
    # The counts of two are mixed.
    publishers.return_value = 2
    assert not ImageInput._follow(there, 20) and there._events.missing == 2
    # So are they where one of them has just gone.
    publishers.return_value = 1
    assert not ImageInput._follow(there, 63) and there._events.missing == 2
    assert ImageInput._follow(there, 65) and there._events.missing == 3


def test_two_nodes_of_one_name_say_so(graph):
    graph.start('marker_tracker')
    graph.spawn('marker_tracker')
    said = '2 nodes are named /marker_tracker'
    graph.until(lambda: said in graph.diagnostics('marker_tracker')['message'], 'the warning')


def test_a_camera_that_follows_a_dead_one_is_not_mixed_with_it():
    """The graph has both for 20 s after a crash."""
    statistics, events = FrameStatistics(), InputEvents()
    processor = SimpleNamespace(resets=0, calibration='none', status='', frames_problem='')
    status = DetectorStatus(statistics, processor)
    images = InputState('/image_raw', ['/cam', '/cam'], events)
    statistics.arrived()
    assert status.report('node', images, []).message == 'running'
    events.alternations += 1
    assert status.report('node', images, []).message == 'running'
    events.alternations += 20
    said = status.report('node', images, []).message
    assert said == '2 publishers on /image_raw: their images are mixed'


def test_a_source_never_warns_without_words(monkeypatch):
    """Its thread notes what went wrong while another one may report."""
    said = []

    class Watched(deque):
        def append(self, noted):
            super().append(noted)
            said.append(status.report('source', paused=False, subscribers=0).message)

    monkeypatch.setattr(diagnostics, 'deque', Watched)
    status = SourceStatus('camera')
    status.trouble('torn')
    assert said == ['torn']


def test_a_source_that_is_paused_says_so():
    status = SourceStatus('video flight.mp4')
    status.state = 'playing'
    said = status.report('source', paused=True, subscribers=1)
    assert (said.message, said.values[0].value) == ('paused', 'paused')


def test_reasons_for_silence():
    events = InputEvents()
    published = InputState('/image_raw', ['/cam'], events)
    nothing = InputState('/image_raw', [], events)

    def why(images):
        return explain_no_images(images, events.lost)

    assert why(nothing) == 'nothing publishes /image_raw'
    assert 'no image arrives: is it paused' in why(published)
    events.lost = 3
    assert 'every image is lost: they may not fit the shared-' in explain_no_images(
        published, events.lost
    )
    events.size = 921_600
    assert 'lost: 0.9 MB may not fit the shared-' in why(published)
    assert 'FASTRTPS_DEFAULT_PROFILES_FILE=/' in why(published)
    events.size = 307_200
    assert 'the network drops' in why(published)
    # What was once does not count, what is now does.
    events.incompatible = 1
    assert 'QoS' not in why(published)
    now = published._replace(obstacle='with an incompatible QoS (best effort …)')
    assert why(now) == '/cam publishes /image_raw with an incompatible QoS (best effort …)'
    coded = nothing._replace(others=[('/image_raw/compressed', 'CompressedImage')])
    assert 'set image_transport to compressed' in why(coded)
    raw = coded._replace(topic='/image_raw/ffmpeg', others=[('/image_raw', 'Image')])
    assert why(raw).endswith('there is /image_raw: set image_transport to raw')
    elsewhere = nothing._replace(others=[('/nose/image', 'Image')])
    assert why(elsewhere).endswith('there is /nose/image: remap image_raw')
    coded = [('/nose/image/compressed', 'CompressedImage')]
    # image_raw was remapped to the compressed topic, or not at all.
    twice = InputState('/nose/image/compressed/compressed', [], events, others=coded)
    there = 'there is /nose/image/compressed: remap image_raw to /nose/image'
    assert why(twice).endswith(there)
    assert why(nothing._replace(others=coded)).endswith(
        f'{there} and set image_transport to compressed'
    )


def test_what_is_left_out_on_purpose_is_no_gap_of_the_camera(graph):
    stream = Stream(graph, 'marker_tracker', **KEEP_EVERYTHING)
    stream.until_answered(stream.play(0.5))
    before = int(graph.diagnostics('marker_tracker')['frames_received'])
    graph.call(SetBool, '/marker_tracker/enable', SetBool.Request(data=False))
    stream.play(0.5)
    graph.until(
        lambda: int(graph.diagnostics('marker_tracker')['frames_received']) >= before + 30, 'images'
    )
    graph.call(SetBool, '/marker_tracker/enable', SetBool.Request(data=True))
    stream.play(0.5)
    values = graph.diagnostics('marker_tracker')
    assert values['frames_left_out_by_stamps'] == '0', values['message']
    assert 'missing' not in values['message']


def test_a_frame_that_is_not_followed_leaves_no_gap():
    monitor = StampMonitor()
    for number in range(10):
        monitor.follow(number * 100)
    monitor.interrupt()
    monitor.follow(1300)
    assert monitor.frames_left_out == 0
    monitor.follow(1600)
    assert monitor.frames_left_out == 2
    # Nor does one that is rejected.
    statistics, image = FrameStatistics(), Image(np.zeros((2, 2), np.uint8), 'mono8')
    for number in (*range(10), 11):
        if number == 11:
            statistics.reject('bad image', 'torn')
        frame = Frame(number * 100, 'camera', image)
        statistics.processed_one(frame, FrameTimes(0.0, 0.0, 0.0, 0.0, 0.0))
    assert statistics.stamps.frames_left_out == 0


def test_a_handover_never_holds_up_the_source(graph):
    begun, free, taken = threading.Event(), threading.Event(), []

    def slow(received):
        begun.set()
        free.wait(5.0)
        taken.append(received.stamp_ns)

    frames = [SimpleNamespace(stamp_ns=number) for number in range(11)]
    handover = IntraProcessInput(graph.probe, '/image_raw', slow)
    handover.start()
    handover.put(frames[0])
    assert begun.wait(5.0)
    for frame in frames[1:10]:
        handover.put(frame)
    free.set()
    while len(taken) < 6:
        threading.Event().wait(0.01)
    handover.close()
    assert taken == [0, 5, 6, 7, 8, 9]
    assert handover.poll().events.skipped == 4
    # The source may be in the middle of a frame by then.
    handover.put(frames[10])


def test_a_loss_of_long_ago_is_not_why_no_image_comes_now():
    """A source that was paused after one lost image was said to lose every image."""
    status = DetectorStatus(FrameStatistics(), SimpleNamespace(resets=0, calibration='none'))
    images = InputState('/image_raw', ['/cam'], InputEvents())
    status.report('node', images, [])
    images.events.lost = 1
    assert 'every image is lost' in status.report('node', images, []).message
    for _ in range(6):
        last = status.report('node', images, [])
    assert 'no image arrives: is it paused' in last.message

"""Managed nodes through `ros2 lifecycle`'s services: every transition, again and again."""

from pathlib import Path

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from sensor_msgs.msg import Image, PointCloud2
from std_srvs.srv import SetBool
from support.live_stream import KEEP_EVERYTHING, RESULTS, Stream, memory_mb
from support.places import ROOT

from mvuav_ros.messages.sensors import stamp_ns_of

CYCLES = 20
NODE = 'marker_tracker'


def change(graph, node, label='', number=0):
    request = ChangeState.Request(transition=Transition(id=number, label=label))
    return graph.call(ChangeState, f'/{node}/change_state', request).success


def state(graph, node):
    return graph.call(GetState, f'/{node}/get_state', GetState.Request()).current_state.label


def resources(pid: int) -> tuple[int, int]:
    """Threads and open files of a process."""
    folder = Path(f'/proc/{pid}')
    return len(list((folder / 'task').iterdir())), len(list((folder / 'fd').iterdir()))


class Cycles:
    """A node under test in front of a camera that never stops."""

    def __init__(self, graph, node):
        self.graph, self.node = graph, node
        self.stream = Stream(graph, node, **KEEP_EVERYTHING)
        self.pid = self.stream.processes[node].pid

    def change(self, *labels):
        for label in labels:
            assert change(self.graph, self.node, label), label

    def sent(self, count) -> list[int]:
        """Publish frames; returns their stamps."""
        stamps = []
        for _ in range(count):
            message = self.stream.good()
            self.stream.publisher.publish(message)
            sec, nanosec = (int.from_bytes(message[4 + i : 8 + i], 'little') for i in (0, 4))
            stamps.append(sec * 10**9 + nanosec)
            self.graph.spin(0.005)
        return stamps

    def subscribed(self, count):
        self.graph.until(
            lambda: self.stream.publisher.get_subscription_count() == count, f'{count} subscribers'
        )

    def answered(self) -> list[int]:
        return [stamp_ns_of(answer.header) for answer in self.stream.answers[self.node]]


def companions_of(graph) -> int:
    """Subscriptions to what belongs to images."""
    return sum(graph.probe.count_subscribers(topic) for topic in ('/camera_info', '/imu'))


@pytest.mark.parametrize('node', RESULTS)
def test_every_image_of_the_active_time_is_answered_and_no_other(graph, node):
    cycles = Cycles(graph, node)
    topic = f'/{node}/{RESULTS[node]}'
    active, first = [], None
    for index in range(CYCLES):
        active += cycles.sent(4)
        graph.until(lambda: cycles.answered() == active, f'answers {index}')  # noqa: B023
        cycles.change('deactivate')
        cycles.subscribed(0)
        graph.until(lambda: not companions_of(graph), 'an end of all subscriptions')
        cycles.sent(3)
        if index % 2:
            cycles.change('cleanup')
            graph.until(
                lambda: graph.probe.count_publishers(f'/{node}/{RESULTS[node]}') == 0, 'out'
            )
            cycles.sent(3)
            assert state(graph, node) == 'unconfigured'
            cycles.change('configure')
            graph.until(lambda: graph.probe.count_publishers(topic) == 1, 'its return')
        cycles.sent(2)
        assert state(graph, node) == 'inactive'
        cycles.change('activate')
        cycles.subscribed(1)
        # Both ends have found each other; the results' subscription of ours has as well.
        graph.spin(0.3)
        if index == 3:
            first = resources(cycles.pid), memory_mb(cycles.pid)
    active += cycles.sent(4)
    graph.until(lambda: cycles.answered() == active, 'the last answers')
    assert resources(cycles.pid) == first[0]
    assert memory_mb(cycles.pid) - first[1] < 10.0
    assert state(graph, node) == 'active'
    cycles.change('shutdown')
    assert state(graph, node) == 'finalized'
    cycles.stream.check_alive()


def test_what_a_state_does_not_allow_is_answered_with_no(graph):
    stream = Stream(graph, NODE, **KEEP_EVERYTHING)
    for request in ({'label': 'configure'}, {'number': 200}, {'label': 'take_off'}, {'number': 2}):
        assert not change(graph, NODE, **request)
        assert state(graph, NODE) == 'active'
    stream.until_answered(stream.play(0.3))
    for label in ('deactivate', 'cleanup'):
        assert change(graph, NODE, label)
        assert not change(graph, NODE, label)
    assert state(graph, NODE) == 'unconfigured'
    assert not change(graph, NODE, 'activate')
    values = graph.diagnostics(NODE)
    assert (values['state'], values['level']) == ('unconfigured', 0)
    answer = graph.call(SetBool, f'/{NODE}/enable', SetBool.Request(data=True))
    assert (answer.success, answer.message) == (True, 'the node is unconfigured')
    assert graph.set_parameter(NODE, 'threshold', 0.6).successful
    stream.check_alive()


def test_without_autostart_it_waits_for_a_manager(graph):
    process = graph.start(NODE, autostart=False)
    assert state(graph, NODE) == 'unconfigured'
    assert graph.probe.count_publishers(f'/{NODE}/markers') == 0
    assert change(graph, NODE, 'configure')
    markers = graph.listen(f'/{NODE}/markers', PointCloud2)
    assert graph.probe.count_subscribers('/image_raw') == 0
    assert change(graph, NODE, 'activate')
    graph.until(lambda: graph.probe.count_subscribers('/image_raw') == 1, 'the subscription')
    assert markers == []
    process.send_signal(2)
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 0 and 'Traceback' not in output, output


def test_files_are_read_when_it_is_configured(graph, tmp_path):
    rig, parameters = tmp_path / 'rig.yaml', tmp_path / 'parameters.yaml'
    body = 'markers: {{{}: [0, 1, 0], b: [0, -1, 0.2], c: [0, 0.3, 1], d: [1, 0, 0.5]}}'
    rig.write_text(body.format('first'))
    parameters.write_text(f'/**:\n  ros__parameters:\n    layout: {rig}\n')
    given = ('--ros-args', '--params-file', str(parameters), '--')
    process = graph.spawn(NODE, arguments=given)
    graph.until(lambda: graph.probe.count_publishers(f'/{NODE}/marker/first') == 1, 'its topics')
    graph.until(lambda: state(graph, NODE) == 'active', 'its start')

    def again() -> bool:
        return all(change(graph, NODE, label) for label in ('deactivate', 'cleanup', 'configure'))

    rig.write_text(body.format('other'))
    # Its values were taken at the start.
    parameters.unlink()
    assert again()
    graph.until(lambda: graph.probe.count_publishers(f'/{NODE}/marker/other') == 1, 'new topics')
    assert change(graph, NODE, 'activate')
    assert state(graph, NODE) == 'active'
    rig.unlink()
    assert not again()
    assert state(graph, NODE) == 'unconfigured'
    process.send_signal(2)
    output, _ = process.communicate(timeout=120)
    assert 'No such file' in output and 'Traceback' not in output, output


def test_a_source_lets_go_of_its_file_and_plays_it_again(graph):
    bag = ROOT / 'bags' / 'tanker.mcap'
    images = graph.received['/image_raw']
    graph.probe.create_subscription(Image, '/image_raw', images.append, 100)
    process = graph.start('video_source', source=bag, rate=100.0)

    def opened() -> bool:
        files = Path(f'/proc/{process.pid}/fd').iterdir()
        return bag in (file.readlink() for file in files)

    graph.until(lambda: len(images) > 5, 'images')
    assert opened()
    threads = resources(process.pid)[0]
    for _ in range(CYCLES):
        assert change(graph, 'video_source', 'deactivate')
        assert not opened()
        graph.until_silent(images)
        images.clear()
        graph.spin(0.1)
        assert images == []
        assert change(graph, 'video_source', 'cleanup')
        assert change(graph, 'video_source', 'configure')
        assert change(graph, 'video_source', 'activate')
        graph.until(lambda: len(images) > 2, 'images')
    assert resources(process.pid)[0] == threads
    assert change(graph, 'video_source', 'shutdown')
    assert graph.diagnostics('video_source')['state'] == 'finalized'


def test_a_source_that_cannot_be_opened_stays_unconfigured(graph, tmp_path):
    graph.start('video_source', source=tmp_path / 'flight.mcap', autostart=False)
    assert not change(graph, 'video_source', 'configure')
    assert state(graph, 'video_source') == 'unconfigured'
    (tmp_path / 'flight.mcap').write_bytes((ROOT / 'bags' / 'tanker.mcap').read_bytes())
    assert change(graph, 'video_source', 'configure')
    assert state(graph, 'video_source') == 'inactive'


def test_detectors_of_one_process_are_managed_one_by_one(graph):
    answers = {}
    for node, topic in RESULTS.items():
        kept = answers[node] = []
        graph.probe.create_subscription(PointCloud2, f'/{node}/{topic}', kept.append, 1000)
    source = ROOT / 'bags' / 'tanker.mcap'
    graph.start('vision_process', wait_for='video_source', source=source, rate=60.0, loop=True)
    graph.until(lambda: all(len(kept) > 5 for kept in answers.values()), 'answers')
    assert change(graph, NODE, 'deactivate')
    graph.until_silent(answers[NODE])
    for kept in answers.values():
        kept.clear()
    graph.until(lambda: len(answers['runway_detector']) > 10, 'answers of the other')
    assert answers[NODE] == []
    assert change(graph, NODE, 'activate')
    graph.until(lambda: len(answers[NODE]) > 5, 'answers')

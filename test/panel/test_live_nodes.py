"""Nodes as the panel finds them, on real DDS."""

import asyncio
import time
from types import SimpleNamespace

import pytest
from rcl_interfaces.msg import SetParametersResult
from sensor_msgs.msg import PointCloud2
from support.graph import Graph

from mvuav_ros.messages.images import COMPRESSED_IMAGE, IMAGE
from mvuav_ros.panel.live_nodes import FoundNode, LiveNode, LiveSystem, _input, find_nodes

KIND = 'marker_tracker'


@pytest.fixture
def graph():
    graph = Graph()
    yield graph
    graph.close()


def test_a_process_in_the_place_of_one_that_died_is_asked_for_its_parameters(graph, monkeypatch):
    """A killed node stays in the graph for a while, and its name is back within a second or two."""

    def start():
        graph.add_node('twin').create_publisher(PointCloud2, '/twin/markers', 1)

    def look():
        return find_nodes(graph.probe).get('/twin')

    start()
    graph.until(look, 'the node')
    before = look()
    start()
    graph.until(lambda: look() != before, 'the process in its place')
    after, read = look(), []

    async def scan():
        async def ask(node):
            read.append(node.found)
            node.unread = False

        system = LiveSystem(None)
        monkeypatch.setattr(system, '_read', ask)
        monkeypatch.setattr(LiveNode, 'connect', lambda *_: None)
        for found in (before, before, after, after):
            system._take({'/twin': found})
            await asyncio.sleep(0)

    asyncio.run(scan())
    assert read == [before, after]


def test_of_many_nodes_that_are_gone_the_last_few_are_kept(monkeypatch):
    """A node with another name at every start filled page and memory until the page was left."""
    monkeypatch.setattr(LiveSystem, '_read', lambda *_: asyncio.sleep(0))
    monkeypatch.setattr(LiveNode, 'connect', lambda *_: None)
    monkeypatch.setattr(LiveNode, 'disconnect', lambda *_: None)

    async def scan():
        system, told = LiveSystem(None), []
        system._listeners.add(lambda what, node: told.append((what, node.name)))
        for number in range(10):
            name = f'/tracker_{number}'
            system._take({'/stays': FoundNode('/stays', KIND), name: FoundNode(name, KIND)})
        assert [*system.nodes] == ['/stays', *(f'/tracker_{number}' for number in range(4, 10))]
        # The page hears that each came, and that it went: it drops what it has of it.
        told_of = [told.count(('nodes', f'/tracker_{number}')) for number in range(10)]
        assert told_of == [2] * 4 + [1] * 6
        system._take({})
        assert [*system.nodes] == [f'/tracker_{number}' for number in range(5, 10)]

    asyncio.run(scan())


def followed(monkeypatch):
    """A system with a node that has answered, whose ROS is not there."""
    monkeypatch.setattr(LiveSystem, '_read', lambda *_: asyncio.sleep(0))
    monkeypatch.setattr(LiveNode, 'connect', lambda *_: None)
    system, found = LiveSystem(None), FoundNode('/tracker', KIND)
    node = system.nodes['/tracker'] = LiveNode(None, found)
    node.alive, node.unread = True, False
    return system, node, {'/tracker': found}


@pytest.mark.parametrize('quiet', [0.0, 1.0, 60.0])
@pytest.mark.parametrize('speaks', [True, False])
def test_a_node_that_says_nothing_for_long_is_asked_again(monkeypatch, quiet, speaks):
    """But not one whose /diagnostics are remapped: it was gone for a second, again and again."""
    system, node, found = followed(monkeypatch)
    # Where it has said nothing yet that is no silence.
    node.last_seen = time.monotonic() - quiet if quiet else 0.0
    node.status = {'state': 'running'} if speaks else {}

    async def scan():
        system._take(found)

    asyncio.run(scan())
    is_silent = speaks and quiet > 4.0
    assert (node.alive, node.unread) == (not is_silent, is_silent)


def test_what_was_not_followed_is_no_silence(monkeypatch):
    system, node, _ = followed(monkeypatch)
    node.last_seen = time.monotonic()
    system._scanning = SimpleNamespace(cancel=lambda: None)
    system.leave(print)
    assert node.unread and node.last_seen == 0.0


def test_a_value_that_is_refused_is_not_shown(monkeypatch):
    system, node, _ = followed(monkeypatch)
    node.values = {'threshold': 0.7, 'mode': 'track'}
    refused = SetParametersResult(successful=False, reason='threshold: must be at most 1')

    async def ask(*_, **__):
        return SimpleNamespace(results=[SetParametersResult(successful=True), refused])

    node.ask = ask
    said = asyncio.run(system.set(node, {'mode': 'detect', 'threshold': 7.0}))
    assert said == {'threshold': 'must be at most 1'}
    assert node.values == {'threshold': 0.7, 'mode': 'detect'}


@pytest.mark.parametrize(('success', 'reason'), [(True, ''), (False, 'not active')])
def test_a_service_that_fails_says_why(success, reason):
    async def request(*_):
        return SimpleNamespace(success=success, message='not active')

    node = SimpleNamespace(create_client=lambda *_: None, destroy_client=lambda _: None)
    system = LiveSystem(SimpleNamespace(node=node, request=request))
    assert asyncio.run(system.trigger('/tracker/reset')) == reason


def test_raw_images_and_the_longer_side_count(monkeypatch):
    both = [('/a/image_raw/compressed', [COMPRESSED_IMAGE]), ('/a/image_raw', [IMAGE])]
    assert _input(both)[:2] == ('/a/image_raw', False)
    assert _input(both[:1])[:2] == ('/a/image_raw/compressed', True)
    _, node, _ = followed(monkeypatch)
    assert node.image_size == 0
    for said in ('640x480 mono8', '480x640 mono8'):
        node.status = {'image': said}
        assert node.image_size == 640

"""Nodes as the panel finds them, on real DDS."""

import asyncio

import pytest
from sensor_msgs.msg import PointCloud2
from support.graph import Graph

from mvuav_ros.panel.live_nodes import FoundNode, LiveNode, LiveSystem, find_nodes

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

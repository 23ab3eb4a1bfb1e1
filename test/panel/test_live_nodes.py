"""Nodes as the panel finds them, on real DDS."""

import asyncio

import pytest
from sensor_msgs.msg import PointCloud2
from support.graph import Graph

from mvuav_ros.panel.live_nodes import LiveNode, LiveSystem, find_nodes


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

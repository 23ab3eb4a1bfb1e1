"""Our own node beside an asyncio loop, on real DDS."""

import asyncio
from itertools import count

import pytest
from rclpy.exceptions import InvalidHandle
from std_msgs.msg import String
from std_srvs.srv import Trigger
from support.graph import Graph

from mvuav_ros.panel.ros_thread import NoAnswerError, RosThread

CYCLES = 100


@pytest.fixture
def graph():
    graph = Graph()
    yield graph
    graph.close()


@pytest.fixture
def ros(graph, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(graph.domain_id))
    ros = RosThread('ours')
    yield ros
    ros.stop()


def test_what_comes_and_goes_beside_a_busy_topic_disturbs_nobody(graph, ros, monkeypatch, capfd):
    spin_once, calls = ros._executor.spin_once, count()

    def as_rclpy_does_now_and_then():
        if next(calls) % 50 == 7:
            raise InvalidHandle('cannot use Destroyable because destruction was requested')
        spin_once()

    monkeypatch.setattr(ros._executor, 'spin_once', as_rclpy_does_now_and_then)
    talker = graph.add_node('talker')
    publisher = talker.create_publisher(String, '/busy', 10)
    talker.create_timer(0.002, lambda: publisher.publish(String(data='x' * 1000)))
    heard = {'standing': 0, 'passing': 0}

    def counter(name):
        return lambda _: ros.call_in_loop(lambda: heard.update({name: heard[name] + 1}))

    async def hears_on():
        before = heard['standing']
        async with asyncio.timeout(60.0):
            while heard['standing'] < before + 5:
                await asyncio.sleep(0.01)

    async def come_and_go():
        ros.start()
        end = ros.subscribe(String, '/busy', counter('standing'))
        for _ in range(CYCLES):
            ends = [ros.subscribe(String, '/busy', counter('passing'), raw=True) for _ in range(4)]
            client = ros.node.create_client(Trigger, '/nobody')
            asked = asyncio.create_task(ros.request(client, Trigger.Request()))
            await hears_on()
            for each in ends:
                each()
            ros.node.destroy_client(client)
            with pytest.raises(NoAnswerError):
                await asked
        await hears_on()
        end()

    asyncio.run(come_and_go())
    assert heard['passing'] > 0
    assert list(ros.node.subscriptions) == []
    assert 'ERROR' not in capfd.readouterr().err

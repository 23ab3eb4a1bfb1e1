"""A node's input and results in a recording, over real DDS."""

import asyncio

import pytest
from geometry_msgs.msg import PointStamped
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, CompressedImage, Imu
from sensor_msgs.msg import Image as RosImage
from support.graph import Graph

from mvuav_ros.messages import poses
from mvuav_ros.panel.image_feed import ImageFeed, ImageStream
from mvuav_ros.panel.live_nodes import FoundNode, LiveNode
from mvuav_ros.panel.node_recorder import NodeRecorder
from mvuav_ros.panel.ros_thread import RosThread
from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.reading import open_recording

FRAMES = 30
TOPICS = {'/nose/image_raw': RosImage, '/nose/camera_info': CameraInfo, '/nose/imu': Imu}


@pytest.fixture
def ros(monkeypatch):
    graph = Graph()
    monkeypatch.setenv('ROS_DOMAIN_ID', str(graph.domain_id))
    ros = RosThread('ours')
    yield ros
    ros.stop()
    graph.close()


def test_all_that_the_node_hears_is_kept_though_the_panel_is_busy(ros, tmp_path):
    """Drivers publish all of it at best effort, and a page that is built takes its time."""
    names = dict(zip(('image_topic', 'camera_info_topic', 'imu_topic'), TOPICS, strict=True))
    node = LiveNode(ros, FoundNode('/tracker', 'marker_tracker', **names))
    publishers = [
        ros.node.create_publisher(kind, topic, qos_profile_sensor_data)
        for topic, kind in TOPICS.items()
    ]
    ended = []

    async def record():
        recorder = NodeRecorder(ros, node, tmp_path / 'flight.mcap', lambda: ended.append(1))
        async with asyncio.timeout(60.0):
            while not all(each.get_subscription_count() for each in publishers):
                await asyncio.sleep(0.02)
            for _ in range(FRAMES):
                for publisher in publishers:
                    filled = {'data': bytes(20_000)} if publisher.msg_type is RosImage else {}
                    publisher.publish(publisher.msg_type(**filled))
            # Only now it comes to listening.
            ros.start()
            while recorder.messages < FRAMES * len(TOPICS):
                await asyncio.sleep(0.02)
        # What the file holds, not the 0.6 MB that came.
        assert recorder.words.endswith(' · 0.0 MB')
        recorder.stop()
        return recorder

    recorder = asyncio.run(record())
    assert ended == [1] and recorder.over == f'Recorded {FRAMES * len(TOPICS)} messages'
    with open_recording(recorder.path) as recording:
        assert {t.name: t.message_count for t in recording.topics} == dict.fromkeys(TOPICS, FRAMES)


def test_the_mount_that_was_published_before_is_kept(ros, tmp_path, monkeypatch):
    """A run over the recording had no camera's mount, as the panel did not listen to it."""
    # Any message does; that of tf2 need not be installed.
    monkeypatch.setattr(poses, 'TF_TYPE', PointStamped)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    ros.node.create_publisher(PointStamped, '/tf_static', latched).publish(PointStamped())
    node = LiveNode(ros, FoundNode('/tracker', 'marker_tracker'))

    async def record():
        recorder = NodeRecorder(ros, node, tmp_path / 'flight.mcap', lambda: None)
        ros.start()
        async with asyncio.timeout(60.0):
            while not recorder.messages:
                await asyncio.sleep(0.02)
        recorder.stop()

    asyncio.run(record())
    with open_recording(tmp_path / 'flight.mcap') as recording:
        assert [each.topic for each in recording.messages()] == ['/tf_static']


def test_a_topic_that_another_node_takes_for_another_type_is_refused_in_words(ros, tmp_path):
    """DDS allows it one type in one process; nothing is left of the recording that began."""
    ros.subscribe(CompressedImage, '/nose/image_raw', lambda _: None)
    node = LiveNode(ros, FoundNode('/tracker', 'marker_tracker', image_topic='/nose/image_raw'))

    async def record():
        NodeRecorder(ros, node, tmp_path / 'flight.mcap', lambda: None)

    with pytest.raises(RecordingError, match='image_raw is no sensor_msgs/msg/Image: this panel'):
        asyncio.run(record())
    assert not list(tmp_path.iterdir())
    feed = ImageFeed(ros)
    feed.look(lambda *_: None, {ImageStream('/tracker', 'input', '/nose/image_raw')})
    assert not feed._taps

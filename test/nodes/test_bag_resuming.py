"""A bag that waits for the detectors; rosbag2 is not on PyPI: its player is a stand-in."""

from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image, PointCloud2
from std_srvs.srv import Trigger
from support.graph import image_message
from support.marker_scenes import draw, tanker_at

PLAYER = 'rosbag2_player'


def test_the_player_is_resumed_once_the_detector_has_found_it(graph, tmp_path):
    """Then no image is lost, the first one neither."""
    package = tmp_path / 'rosbag2_interfaces'
    package.mkdir()
    (package / '__init__.py').touch()
    (package / 'srv.py').write_text('from std_srvs.srv import Trigger as Resume\n')
    resumed = []
    player = graph.add_node(PLAYER)

    def resume(_, response):
        resumed.append(True)
        return response

    player.create_service(Trigger, f'/{PLAYER}/resume', resume)
    environment = {'PYTHONPATH': str(tmp_path)}
    resumer = graph.spawn('resume_bag', arguments=('1',), environment=environment)
    publisher = player.create_publisher(Image, '/image_raw', QoSProfile(depth=100))
    graph.spin(2.0)
    assert not resumed
    # However long the node has to wait for the processor.
    everything = {
        'qos_overrides./image_raw.subscription.reliability': 'reliable',
        'qos_overrides./image_raw.subscription.history': 'keep_all',
        'qos_overrides./marker_tracker/markers.publisher.history': 'keep_all',
    }
    graph.start('marker_tracker', **everything)
    answers = graph.listen('/marker_tracker/markers', PointCloud2)
    graph.until(lambda: bool(resumed), 'the resumption')
    for index in range(30):
        publisher.publish(image_message(draw(tanker_at()), index))
        graph.spin(0.02)
    graph.until(lambda: len(answers) == 30, 'an answer to every image')
    output, _ = resumer.communicate(timeout=60)
    assert '/marker_tracker found the bag' in output
    assert resumer.returncode == 0


def test_without_rosbag2_it_says_what_to_install(graph):
    resumer = graph.spawn('resume_bag', arguments=('1',))
    output, _ = resumer.communicate(timeout=60)
    assert 'apt install ros-jazzy-rosbag2' in output and resumer.returncode == 1

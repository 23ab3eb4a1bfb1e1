"""marker_tracker as a process on real DDS."""

import importlib.util
import math
from itertools import islice

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped, Vector3Stamped
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from std_srvs.srv import SetBool, Trigger
from support.coded_videos import packets
from support.graph import image_message
from support.headers import header_bytes
from support.live_stream import KEEP_EVERYTHING
from support.marker_scenes import draw, tanker_at

from mvuav_ros.messages.cdr import view_points
from mvuav_ros.messages.sensors import encode_camera_info
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.simulation.settings import TankerSettings
from mvuav_ros.simulation.tanker_flight import TankerFlight
from mvuav_ros.vision.camera import CameraModel

NODE = 'marker_tracker'


def flight(first, count, **keywords):
    return [
        image_message(draw(tanker_at(320 + i, 240)), i, **keywords)
        for i in range(first, first + count)
    ]


def test_one_answer_for_every_image_with_its_header(graph):
    graph.start(NODE, **KEEP_EVERYTHING)
    markers = graph.listen(f'/{NODE}/markers', PointCloud2)
    rpy = graph.listen(f'/{NODE}/rpy', Vector3Stamped)
    rudder = graph.listen(f'/{NODE}/marker/rudder', PointStamped)
    images = flight(0, 20)
    images[10] = image_message(draw([]), 10)
    graph.publish_images(images)
    graph.until(lambda: len(markers) == len(rpy) == len(rudder) == 20, '20 answers')
    assert [m.header for m in markers] == [i.header for i in images]
    assert [m.header for m in rpy] == [i.header for i in images]
    assert markers[0].header.frame_id == 'nose'
    points = view_points(markers[5])
    numbers = ('x', 'y', 'z', 'vx', 'vy', 'ax', 'ay', 'area', 'label', 'state', 'confidence')
    assert points.dtype.names == numbers
    assert list(points['label']) == [0, 1, 2, 3, 4]
    assert list(points['state']) == [1] * 5
    assert points['x'] == pytest.approx(tanker_at(325, 240)[:, 0], abs=0.05)
    assert points['vx'] == pytest.approx(30.0, abs=3.0)
    assert markers[5].is_dense
    assert rpy[5].vector.x == pytest.approx(0.0, abs=1e-3)
    assert math.isnan(rpy[5].vector.y) and math.isnan(rpy[5].vector.z)
    assert list(view_points(markers[10])['state']) == [2] * 5
    assert rudder[5].point.x == pytest.approx(325, abs=0.05)


def test_an_image_waits_for_the_camera_info_of_its_stamp(graph):
    """Drivers publish the image first; the first frame has a pose like all others."""
    flown = TankerFlight(TankerSettings(motion='docking', frames=90))
    graph.start(NODE, **KEEP_EVERYTHING)
    rpy = graph.listen(f'/{NODE}/rpy', Vector3Stamped)
    infos = graph.probe.create_publisher(CameraInfo, '/camera_info', QoSProfile(depth=1000))
    graph.until(lambda: infos.get_subscription_count() > 0, 'a subscriber of camera_info')
    graph.spin(0.3)
    for index, frame in enumerate(islice(flown, 10)):
        image = image_message(frame.image.pixels, index)
        graph.publish_images([image], hz=1e6)
        infos.publish(encode_camera_info(flown.camera, header_bytes(image.header)))
        graph.spin(0.02)
    graph.until(lambda: len(rpy) == 10, '10 answers')
    assert not any(math.isnan(message.vector.y) for message in rpy)


def test_images_whose_topic_says_so_are_rectified(graph):
    """P holds for them, not the K and d beside it; /diagnostics says so."""
    flown = TankerFlight(TankerSettings(motion='docking', frames=90))
    right = flown.camera
    fx, _, cx, _, fy, cy, *_ = right.k
    p = (fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0)
    wrong_k = tuple(0.5 * value for value in right.k[:8])
    raw = CameraModel(right.width, right.height, (*wrong_k, 1.0), (-0.3, 0.1, 0.0, 0.0), p=p)
    graph.start(NODE, remap=('image_raw:=/nose/image_rect',))
    poses = graph.listen(f'/{NODE}/pose', PoseWithCovarianceStamped)
    infos = graph.probe.create_publisher(CameraInfo, '/nose/camera_info', QoSProfile(depth=10))
    images = graph.probe.create_publisher(Image, '/nose/image_rect', QoSProfile(depth=10))
    heard = images.get_subscription_count, infos.get_subscription_count
    graph.until(lambda: all(count() for count in heard), 'subscribers')
    for index, frame in enumerate(islice(flown, 6)):
        image = image_message(frame.image.pixels, index)
        infos.publish(encode_camera_info(raw, header_bytes(image.header)))
        images.publish(image)
        graph.until(lambda: len(poses) > index, 'an answer')  # noqa: B023
        if index > 2:
            place = poses[-1].pose.pose.position
            truth = np.linalg.norm(frame.truth.translation)
            assert np.linalg.norm((place.x, place.y, place.z)) == pytest.approx(truth, rel=0.01)
    assert graph.diagnostics(NODE)['calibration'] == 'P: the images are rectified'


def test_parameters_change_between_frames(graph):
    graph.start(NODE, mode='detect_any', **KEEP_EVERYTHING)
    markers = graph.listen(f'/{NODE}/markers', PointCloud2)
    image = draw(tanker_at())
    image[image == 255] = 200
    graph.publish_images([image_message(image, 0)])
    graph.until(lambda: len(markers) == 1, 'an answer')
    assert markers[0].width == 5

    assert graph.set_parameter(NODE, 'threshold', 0.8).successful
    graph.publish_images([image_message(image, 1)])
    graph.until(lambda: len(markers) == 2, 'an answer')
    assert markers[1].width == 0

    # A whole number for a floating-point parameter.
    assert graph.set_parameter(NODE, 'threshold', 1).successful
    assert graph.get_parameter(NODE, 'threshold') == 1.0

    # A value that is refused changes nothing.
    assert graph.set_parameter(NODE, 'threshold', 0.7).successful
    assert graph.set_parameter(NODE, 'min_area', 10).successful
    assert 'min_area (10)' in graph.set_parameter(NODE, 'max_area', 5).reason
    graph.publish_images([image_message(image, 2)])
    graph.until(lambda: len(markers) == 3, 'an answer')
    assert markers[2].width == 5


@pytest.mark.parametrize(('prediction', 'state'), [('acceleration', 1), ('none', 0)])
def test_prediction_takes_effect_on_the_next_frame(graph, prediction, state):
    """Speeding up by 2 px a frame each frame outruns a window that does not lead."""
    graph.start(NODE, prediction='none', search_radius=12, lost_timeout=0.1, **KEEP_EVERYTHING)
    markers = graph.listen(f'/{NODE}/markers', PointCloud2)

    def accelerating(first, last):
        return [image_message(draw(tanker_at(160 + i * i, 240)), i) for i in range(first, last)]

    graph.publish_images(accelerating(0, 5))
    graph.until(lambda: len(markers) == 5, '5 answers')
    assert graph.set_parameter(NODE, 'prediction', prediction).successful
    # Without the left wing in view, the search of the whole frame cannot rescue anything.
    half = [image_message(draw(tanker_at(160 + i * i, 240)[1:]), i) for i in range(5, 18)]
    graph.publish_images(half)
    graph.until(lambda: len(markers) == 18, '18 answers')
    points = view_points(markers[-1])[1:]
    assert list(points['state']) == [state] * 4
    if state:
        assert points['x'] == pytest.approx(tanker_at(160 + 17 * 17, 240)[1:, 0], abs=0.3)


def test_every_parameter_is_declared_with_its_documentation(graph):
    graph.start(NODE, **KEEP_EVERYTHING)
    names = list(MarkerTrackerParameters.names())
    for spec, descriptor in zip(
        MarkerTrackerParameters.specs(), graph.describe_parameters(NODE, names), strict=True
    ):
        assert descriptor.name == spec.name
        assert descriptor.description.startswith(spec.description)
        assert descriptor.read_only == spec.read_only
        if spec.limits is not None and spec.type is not tuple:
            (limits,) = descriptor.floating_point_range or descriptor.integer_range
            assert (limits.from_value, limits.to_value) == spec.limits


def test_services(graph):
    graph.start(NODE, **KEEP_EVERYTHING)
    markers = graph.listen(f'/{NODE}/markers', PointCloud2)
    graph.publish_images(flight(0, 5))
    graph.until(lambda: len(markers) == 5, '5 answers')
    assert graph.call(Trigger, f'/{NODE}/reset', Trigger.Request()).success
    graph.publish_images(flight(5, 1))
    graph.until(lambda: len(markers) == 6, '6 answers')
    assert all(math.isnan(v) for v in view_points(markers[5])['vx'])
    assert graph.call(SetBool, f'/{NODE}/enable', SetBool.Request(data=False)).success
    graph.publish_images(flight(6, 3))
    graph.until(lambda: graph.diagnostics(NODE)['frames_received'] == '9', '9 images')
    assert graph.diagnostics(NODE)['state'] == 'disabled'
    assert graph.call(SetBool, f'/{NODE}/enable', SetBool.Request(data=True)).success
    graph.publish_images(flight(9, 1))
    graph.until(lambda: len(markers) == 7, '7 answers')


def test_compressed_images_in_a_namespace_under_another_name(graph):
    import cv2

    graph.start(NODE, image_transport='compressed', remap=('image_raw:=/nose/image',))
    markers = graph.listen(f'/{NODE}/markers', PointCloud2)
    topic = '/nose/image/compressed'
    broken = CompressedImage(format='jpeg', data=b'not a jpeg')
    graph.publish_images([broken], topic=topic)
    graph.until(lambda: graph.diagnostics(NODE).get('rejected_bad_image') == '1', 'a refusal')
    # One by one: of a queue a busy machine leaves some out.
    for index, image in enumerate(flight(0, 5)):
        data = cv2.imencode('.png', draw(tanker_at(320 + index, 240)))[1].tobytes()
        message = CompressedImage(header=image.header, format='mono8; png', data=data)
        graph.publish_images([message], topic=topic)
        graph.until(lambda: len(markers) > index, 'an answer')  # noqa: B023
    assert list(view_points(markers[4])['state']) == [1] * 5


def test_a_camera_that_sends_h264(graph):
    graph.start(NODE, image_transport='compressed', mode='detect_any', **KEEP_EVERYTHING)
    markers = graph.listen(f'/{NODE}/markers', PointCloud2)
    images = flight(0, 12)
    messages = [
        CompressedImage(header=image.header, format='h264', data=data)
        for image, data in zip(images, packets('libx264', 12), strict=True)
    ]
    graph.publish_images(messages, topic='/image_raw/compressed')
    graph.until(lambda: len(markers) == 12, '12 answers')
    assert [message.header for message in markers] == [image.header for image in images]
    assert 'rejected_bad_image' not in graph.diagnostics(NODE)


def test_a_transport_whose_messages_are_missing_is_said(graph):
    if importlib.util.find_spec('ffmpeg_image_transport_msgs'):
        pytest.skip('they are installed here')
    process = graph.spawn(NODE, image_transport='ffmpeg')
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 2
    assert 'apt install ros-jazzy-ffmpeg-image-transport-msgs' in output.splitlines()[-1]

"""runway_detector as a process on real DDS."""

import math

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_srvs.srv import Trigger
from support.graph import image_message
from support.live_stream import KEEP_EVERYTHING
from visualization_msgs.msg import Marker

from mvuav_ros.messages.cdr import view_points
from mvuav_ros.messages.images import decode_image

NODE = 'runway_detector'
LINES = {'left': ((140, 20), (60, 239)), 'middle': ((160, 20), (160, 239))}


def runway(lines=LINES, size=(320, 240), color=(0, 0, 255)) -> np.ndarray:
    """Lines on grey, red by default, so that only the red channel and intensity see them."""
    image = np.full((size[1], size[0], 3), (90, 90, 90), np.uint8)
    for start, end in lines.values():
        cv2.line(image, start, end, color, 5, cv2.LINE_AA)
    return image


def listen(graph):
    return graph.listen(f'/{NODE}/line_params', PointCloud2)


def rows(message):
    return view_points(message)


def found(message):
    return int(np.isfinite(rows(message)['rho']).sum())


class Frames:
    """Publishes one frame after the other and waits for its lines."""

    def __init__(self, graph, answers):
        self.graph, self.answers, self.index = graph, answers, 0

    def show(self, image, count=1):
        for _ in range(count):
            before = len(self.answers)
            self.graph.publish_images([image_message(image, self.index)])
            self.index += 1
            self.graph.until(lambda: len(self.answers) > before, 'an answer')  # noqa: B023
        return self.answers[-1]


@pytest.fixture
def frames(graph):
    graph.start(NODE, **KEEP_EVERYTHING)
    return Frames(graph, listen(graph))


def test_one_answer_for_every_image_on_every_topic(graph):
    graph.start(NODE, **KEEP_EVERYTHING)
    params = listen(graph)
    markers = graph.listen(f'/{NODE}/lines', Marker)
    corrections = graph.listen(f'/{NODE}/corrections', DiagnosticArray)
    images = [image_message(runway(), i) for i in range(10)]
    images[4] = image_message(np.full((240, 320, 3), 90, np.uint8), 4)
    graph.publish_images(images)
    graph.until(lambda: len(params) == len(markers) == len(corrections) == 10, '10 answers')
    for answers in (params, markers, corrections):
        assert [answer.header for answer in answers] == [image.header for image in images]
    points = rows(params[3])
    names = ('x', 'y', 'z', 'x2', 'y2', 'rho', 'theta', 'votes', 'rho_raw', 'theta_raw', 'flags')
    assert points.dtype.names == (*names, 'role', 'confidence')
    assert len(points) == 3
    for row in points[np.isfinite(points['rho'])]:
        normal = math.cos(row['theta']), math.sin(row['theta'])
        for x, y in ((row['x'], row['y']), (row['x2'], row['y2'])):
            assert x * normal[0] + y * normal[1] == pytest.approx(row['rho'], abs=1e-2)
            assert -0.5 <= x <= 319.5 and -0.5 <= y <= 239.5
        # An edge of a stroke lies within 4 px of its middle at row 90.
        at_row = (row['rho'] - 90 * normal[1]) / normal[0]
        assert min(abs(at_row - 160), abs(at_row - 114.4)) < 5
    assert np.isnan(rows(params[4])['rho']).all()
    assert list(rows(params[4])['flags']) == [0, 0, 0]
    assert not params[4].is_dense
    assert markers[3].type == Marker.LINE_LIST
    assert len(markers[3].points) == len(markers[3].colors) == 2 * found(params[3])
    assert markers[4].points == []
    (first, *_) = corrections[3].status
    assert {pair.key for pair in first.values} == {
        'rho', 'theta_deg', 'rho_flag', 'theta_flag', 'corrected'
    }  # fmt: skip
    assert [status.level[0] for status in corrections[4].status] == [1, 1, 1]


def test_every_gui_input_takes_effect_on_the_next_frame(frames):
    graph, image = frames.graph, runway()

    def change(**values):
        for name, value in values.items():
            result = graph.set_parameter(NODE, name, value)
            assert result.successful, result.reason
        return frames.show(image)

    assert found(frames.show(image)) == 3
    assert len(rows(change(num_peaks=5))) == 5
    # The lines are red on grey; a grey image of the frame's blue has none of their votes.
    blue = rows(change(channel='blue'))
    red = rows(change(channel='red'))
    assert not np.array_equal(blue['votes'], red['votes'])
    assert found(change(peak_threshold=100_000)) == 0
    assert found(change(peak_threshold=15)) > 0
    assert found(change(edge_threshold=1.0)) == 0
    assert found(change(edge_threshold=0)) > 0
    # A tall element removes the slanted line and leaves the upright one.
    upright = np.nansum(rows(change(opening_length=41))['votes'])
    votes = rows(change(opening_length=1))['votes']
    assert np.nansum(votes) > 1.2 * upright
    whole = rows(change(start_row=0, end_row=240))['votes']
    assert np.nanmax(whole) > 1.5 * np.nanmax(votes)
    assert np.nanmax(rows(change(start_row=100))['votes']) < np.nanmax(whole)
    change(rho_resolution=1, theta_resolution_deg=0.5)
    fine = rows(change(peak_neighborhood_rho=1, peak_neighborhood_theta=1, num_peaks=6))
    assert found(frames.answers[-1]) == 6
    coarse = rows(change(peak_neighborhood_rho=301, peak_neighborhood_theta=301))
    assert np.isfinite(coarse['rho']).sum() < np.isfinite(fine['rho']).sum()


@pytest.mark.parametrize(
    ('name', 'value', 'reason'),
    [
        ('peak_neighborhood_rho', 10, 'odd'),
        ('start_row', 130, 'start_row (130)'),
        ('rho_resolution', 0, 'rho_resolution: must be'),
        ('rho_error_threshold', float('nan'), 'nan'),
        ('channel', 'infrared', 'red, green, blue, intensity'),
        ('num_peaks', 2.5, 'takes a whole number'),
        ('rho_resolution', 'fine', 'takes a number'),
        ('image_transport', 'compressed', 'while the node is unconfigured'),
        ('camera_mount_rpy_deg', '[0, 20.5, 0]', 'all alike: [0.0, 20.5, 0.0]'),
    ],
)
def test_bad_values_are_refused_with_the_reason(shared_node, name, value, reason):
    before = shared_node.get_parameter(NODE, name)
    result = shared_node.set_parameter(NODE, name, value)
    assert not result.successful
    assert reason in result.reason
    assert shared_node.get_parameter(NODE, name) == before


@pytest.fixture(scope='module')
def shared_node():
    from support.graph import Graph

    graph = Graph()
    graph.start(NODE, **KEEP_EVERYTHING)
    yield graph
    graph.close()


@pytest.mark.parametrize(('start', 'end'), [(200, 340), (10, 40), (50, 130), (0, 0), (50, 130)])
def test_a_set_of_parameters_loads_in_any_order(shared_node, start, end):
    """`ros2 param load` sends one request; rclpy sets its values one by one."""
    request = SetParameters.Request(
        parameters=[
            Parameter('end_row', value=end).to_parameter_msg(),
            Parameter('rho_resolution', value=0.0).to_parameter_msg(),
            Parameter('start_row', value=start).to_parameter_msg(),
        ]
    )
    answer = shared_node.call(SetParameters, f'/{NODE}/set_parameters', request)
    assert [result.successful for result in answer.results] == [True, False, True]
    assert shared_node.get_parameter(NODE, 'start_row') == start
    assert shared_node.get_parameter(NODE, 'end_row') == end
    assert shared_node.get_parameter(NODE, 'rho_resolution') == 2.0


def test_statistics_can_have_another_qos_as_all_results(graph):
    """The override was refused as a parameter without effect."""
    name = f'qos_overrides./{NODE}/statistics.publisher.depth'
    graph.start(NODE, **{name: 3})
    assert graph.get_parameter(NODE, name) == 3


def test_statistics_and_their_reset(frames):
    graph = frames.graph
    statistics = graph.listen(f'/{NODE}/statistics', DiagnosticArray)
    frames.show(runway(), 5)

    def newest(frame_count):
        def fits():
            return any(m.status[0].message == f'{frame_count} frames' for m in statistics)

        graph.until(fits, f'statistics of {frame_count} frames')
        message = next(m for m in statistics if m.status[0].message == f'{frame_count} frames')
        statistics.clear()
        return [{pair.key: pair.value for pair in status.values} for status in message.status]

    total, *lines = newest(5)
    assert total['frames'] == '5' and total['rho_flags'] == '0'
    assert len(lines) == 3
    points = rows(frames.answers[-1])
    for line, point in zip(lines, points, strict=True):
        assert float(line['rho_mean']) == pytest.approx(point['rho'], abs=0.01)
        assert float(line['rho_std']) == pytest.approx(0.0, abs=1e-6)
        assert float(line['theta_mean_deg']) == pytest.approx(
            math.degrees(point['theta']), abs=0.01
        )
    answer = graph.call(Trigger, f'/{NODE}/reset_statistics', Trigger.Request())
    assert answer.success and answer.message == 'the statistics begin at zero'
    newest(0)
    frames.show(runway(), 2)
    newest(2)


def test_debug_images_only_while_somebody_looks(frames):
    graph = frames.graph
    frames.show(runway(), 2)
    images = {
        name: graph.listen(f'/{NODE}/debug/{name}', Image)
        for name in ('confined', 'edges', 'hough', 'overlay')
    }
    for _ in range(200):
        # Until the node has seen all subscriptions.
        frames.show(runway())
        if all(images.values()):
            break
    assert all(images.values())
    header = frames.show(runway()).header

    def counts():
        return [sum(image.header == header for image in p) for p in images.values()]

    graph.until(lambda: all(counts()), 'four images of one frame')
    graph.spin(0.2)
    assert counts() == [1, 1, 1, 1]
    confined = decode_image(images['confined'][0])
    np.testing.assert_array_equal(confined.pixels, runway()[50:130, :, 2])
    edges = decode_image(images['edges'][0]).pixels
    assert edges.shape == (80, 320) and set(np.unique(edges)) == {0, 255}
    assert decode_image(images['overlay'][0]).pixels.shape == (240, 320, 3)
    hough = decode_image(images['hough'][0]).pixels
    assert hough.max() > 200


@pytest.mark.parametrize('mode', ['thesis', 'approach'])
def test_images_wait_for_a_camera_info_that_never_comes_but_not_for_ever(graph, mode):
    graph.start(NODE, mode=mode, **KEEP_EVERYTHING)
    graph.probe.create_publisher(CameraInfo, '/camera_info', 10)
    answers = listen(graph)
    graph.publish_images([image_message(runway(), i) for i in range(10)], hz=20)
    graph.until(lambda: len(answers) == 10, '10 answers')
    values = graph.diagnostics(NODE)
    # The first three wait for 0.1 s, in vain; those after them do not.
    assert float(values['latency_p99_ms']) >= 95.0
    assert values['frames_processed'] == '10'

"""Red left and green right, as an aircraft's navigation lights, in every drawing."""

import numpy as np

from mvuav_ros.vision.approach.overlay import ROLE_COLORS
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.drawing import draw_markers
from mvuav_ros.vision.markers.marker_results import Marker, MarkerResult, MarkerState
from mvuav_ros.vision.markers.tracker import MarkerTracker
from mvuav_ros.vision.rig import TANKER_747
from mvuav_ros.vision.runway.results import LineRole

LIGHTS = ((60, 100), (110, 90), (160, 40), (210, 90), (260, 100))


def hue(color):
    blue, green, red = map(int, color)
    return 'red' if red > max(blue, green) else 'green' if green > max(blue, red) else 'blue'


def test_the_marks_of_left_lights_are_red_and_those_of_right_ones_green():
    pixels = np.zeros((200, 320), np.uint8)
    for x, y in LIGHTS:
        pixels[y - 1 : y + 2, x - 1 : x + 2] = 255
    image = Image(pixels, 'mono8')
    tracker = MarkerTracker()
    result = tracker.process(image, 0)
    canvas = draw_markers(image, result)
    for name, marker in zip(TANKER_747.names, result.markers, strict=True):
        x, y = round(marker.x), round(marker.y)
        part = canvas[y - 8 : y + 9, x - 8 : x + 9].reshape(-1, 3)
        drawn = part[np.ptp(part, axis=1) > 60]
        wanted = 'red' if 'left' in name else 'green' if 'right' in name else 'blue'
        assert len(drawn) and {hue(color) for color in drawn} == {wanted}, name


def test_the_marks_of_another_rig_are_alike_and_none_looks_predicted():
    """They were drawn as the tanker's of the same numbers, and from the sixth on in yellow."""
    image = Image(np.zeros((40, 320), np.uint8), 'mono8')
    row = [Marker(i, MarkerState.DETECTED, 30.0 + 40 * i, 20.0) for i in range(7)]
    canvas = draw_markers(image, MarkerResult(tuple(row)))
    first = canvas[11:30, 21:40]
    assert {hue(color) for color in first[np.ptp(first, axis=2) > 60]} == {'green'}
    for i in range(7):
        np.testing.assert_array_equal(canvas[11:30, 21 + 40 * i : 40 + 40 * i], first)


def test_so_are_the_edges_of_a_runway():
    assert hue(ROLE_COLORS[LineRole.LEFT_EDGE]) == 'red'
    assert hue(ROLE_COLORS[LineRole.RIGHT_EDGE]) == 'green'

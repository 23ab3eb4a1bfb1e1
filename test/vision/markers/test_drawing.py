"""Red left and green right, as an aircraft's navigation lights, in every drawing."""

import math

import numpy as np

from mvuav_ros.vision.approach.overlay import ROLE_COLORS
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.drawing import YELLOW, draw_markers, draw_pose
from mvuav_ros.vision.markers.marker_results import Marker, MarkerResult, MarkerState, Window
from mvuav_ros.vision.markers.tracker import MarkerTracker
from mvuav_ros.vision.pose import Pose
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


def test_the_marks_of_another_rig_have_a_colour_and_a_name_of_their_own():
    """They were all alike; none looks predicted, or as the tanker's of the same number."""
    image = Image(np.zeros((480, 1600), np.uint8), 'mono8')
    row = [Marker(i, MarkerState.DETECTED, 30.0 + 120 * i, 200.0) for i in range(12)]
    names = tuple(f'light {letter}' for letter in 'abcdefghijkl')
    named, numbered = (draw_markers(image, MarkerResult(tuple(row)), each) for each in (names, ()))
    size, colors, words = 8, [], set()
    for marker in row:
        x, y = round(marker.x), round(marker.y)
        beside = np.s_[y - 12 : y + 13, x + 14 : x + 100]
        colors.append(named[y, x + size].astype(int))
        assert named[beside].any() and (named[beside] != numbered[beside]).any()
        words.add((named[beside].max(axis=2) > 128).tobytes())
    assert len(words) == len(names)
    yellow = np.array(YELLOW)
    for i, color in enumerate(colors):
        apart = [np.abs(np.subtract(color, other)).max() for other in (*colors[:i], yellow)]
        assert min(apart) > 40, (i, color)


def test_axes_that_a_lens_does_not_show_are_not_drawn():
    """Its model turns back, and has places in the image for what is far aside."""
    matrix = (300.0, 0.0, 320.0, 0.0, 300.0, 240.0, 0.0, 0.0, 1.0)
    camera = CameraModel(640, 480, matrix, (-0.3, 0.0, 0.0, 0.0))
    for aside, is_drawn in ((0.5, True), (1.7, False)):
        place = np.array((aside * 100.0, 0.0, 100.0)) - OPTICAL_FROM_BODY @ TANKER_747.dock
        pose = Pose(OPTICAL_FROM_BODY, place, np.eye(6), np.full((5, 2), math.nan), 0.1)
        canvas = np.zeros((480, 640, 3), np.uint8)
        draw_pose(canvas, pose, camera, TANKER_747)
        assert canvas.any() == is_drawn


def test_an_empty_search_window_is_not_drawn():
    """It was a pixel in the corner, or a line along the border."""
    image = Image(np.zeros((60, 80), np.uint8), 'mono8')
    lost = tuple(Marker(index, MarkerState.LOST) for index in range(3))
    places = (math.inf, 30.0), (-11.0, 30.0), (40.0, 70.0)
    windows = tuple(Window.around(x, y, 10, (80, 60)) for x, y in places)
    drawn = draw_markers(image, MarkerResult(lost, windows=windows))
    assert (drawn == draw_markers(image, MarkerResult(lost))).all()


def test_so_are_the_edges_of_a_runway():
    assert hue(ROLE_COLORS[LineRole.LEFT_EDGE]) == 'red'
    assert hue(ROLE_COLORS[LineRole.RIGHT_EDGE]) == 'green'

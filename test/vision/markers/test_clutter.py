"""Lights that are not the marker whose name they had."""

from mvuav_ros.vision.markers.assignment import Expectation
from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.search import REJECTED_FOR, Rejections


def light(x: float) -> Detection:
    return Detection(x, 100.0, 40, 1.0)


def rejected() -> Rejections:
    rejections = Rejections()
    rejections.add(2, light(50.0))
    return rejections


def test_the_light_is_refused_for_that_marker_alone():
    rejections = rejected()
    assert rejections.concern(2, light(52.0))
    assert not rejections.concern(2, light(70.0))
    assert not rejections.concern(1, light(50.0))


def test_it_is_followed_until_it_is_forgotten():
    rejections = rejected()
    far = {2: Expectation(50.0, 400.0, 1.0)}
    for frame in range(REJECTED_FOR - 1):
        rejections.follow([light(50.0 + 5 * (frame + 1))], far)
    last = light(50.0 + 5 * (REJECTED_FOR - 1))
    assert rejections.concern(2, last)
    rejections.follow([last], far)
    assert not rejections.concern(2, last)


def test_a_light_right_where_the_others_put_the_marker_is_the_marker():
    rejections = rejected()
    rejections.follow([light(50.0)], {2: Expectation(50.5, 100.0, 6.0)})
    assert rejections.concern(2, light(50.0)), 'the place is hardly known'
    rejections.follow([light(50.0)], {2: Expectation(50.5, 100.0, 1.0)})
    assert not rejections.concern(2, light(50.0))


def test_a_marker_with_a_light_of_its_own_is_not_concerned():
    rejections = rejected()
    rejections.follow([light(50.0)], {})
    assert not rejections.concern(2, light(50.0))

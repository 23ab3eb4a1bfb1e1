"""Lights that are no markers."""

from mvuav_ros.vision.markers.lights import Detection, Light
from mvuav_ros.vision.markers.marker_memory import Expectation
from mvuav_ros.vision.markers.naming import REMEMBERED, SETTLED, Clutter

PLACE = {2: Expectation(100.0, 100.0, 1.0)}


def light(x: float) -> Light:
    return Light(x, 100.0, Detection(x, 100.0, 40, 1.0))


def test_a_light_far_from_every_place_is_clutter_and_is_followed():
    clutter = Clutter()
    for frame in range(4):
        assert clutter.include([light(300.0 + 5 * frame)]).all() == (frame > 0)
        clutter.update([light(300.0 + 5 * frame)], PLACE)
    assert not clutter.include([light(340.0)]).all()


def test_a_light_beside_the_place_of_a_marker_may_be_the_marker():
    clutter = Clutter()
    for _ in range(6):
        clutter.update([light(104.0)], PLACE)
    assert not clutter.include([light(104.0)]).all()
    assert not clutter.is_about


def test_while_the_body_is_out_of_sight_only_what_was_clutter_is():
    clutter = Clutter()
    clutter.update([light(300.0)], {})
    clutter.update([light(300.0), light(400.0)], None)
    assert clutter.include([light(300.0)]).all()
    assert not clutter.include([light(400.0)]).all()


def test_clutter_is_remembered_for_some_seconds():
    clutter = Clutter()
    assert not clutter.is_about
    clutter.update([light(300.0)], {})
    for _ in range(REMEMBERED - 1):
        clutter.update([], {})
        assert clutter.is_about
    clutter.update([], {})
    assert not clutter.is_about


def settled(*lights: Light) -> Clutter:
    """Some that has been there for long."""
    clutter = Clutter()
    for _ in range(SETTLED + 1):
        clutter.update(lights, {})
    return clutter


def test_other_lights_may_be_clutter_while_less_of_it_is_in_sight_than_there_was():
    clutter = settled(light(300.0), light(400.0))
    assert not clutter.may_be_new
    clutter.update([light(300.0)], {})
    assert clutter.may_be_new
    clutter.update([light(300.0), light(400.0)], None)
    assert clutter.may_be_new
    for _ in range(REMEMBERED):
        clutter.update([], {})
    assert not clutter.may_be_new


def test_other_lights_may_be_clutter_for_a_second_after_one_came():
    clutter = settled(light(300.0))
    clutter.update([light(300.0), light(500.0)], {})
    for _ in range(SETTLED):
        assert clutter.may_be_new
        clutter.update([light(300.0), light(500.0)], None)
    assert not clutter.may_be_new

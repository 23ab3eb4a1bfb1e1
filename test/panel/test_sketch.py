"""A pose as numbers and lines."""

import math

import numpy as np
import pytest
from geometry_msgs.msg import Quaternion

from mvuav_ros.panel.sketch import rotation_of, sketch_runway, sketch_tanker

LEVEL = np.eye(3)
AHEAD = np.array([(0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])


def by_color(sketch, color):
    return [segment[1:] for segment in sketch.segments if segment[0] == color]


def test_on_the_centreline_the_runway_lies_in_the_middle_below_a_level_horizon():
    sketch = sketch_runway((-500.0, 0.0, 50.0), LEVEL, 45.0)
    ((_, y1, _, y2),) = by_color(sketch, 'accent')
    assert y1 == pytest.approx(0.0, abs=1e-3) and y2 == pytest.approx(0.0, abs=1e-3)
    x1, y1, *_ = by_color(sketch, 'soft')[0]
    assert x1 == pytest.approx(0.0) and y1 == pytest.approx(1.6 * 50 / 500, abs=1e-3)
    assert dict(sketch.numbers)['height'] == '50.0 m'
    assert dict(sketch.numbers)['before the near end'] == '500.0 m'


def test_a_roll_to_the_right_turns_the_horizon_to_the_left():
    roll = math.radians(20.0)
    turn = rotation_of(Quaternion(x=math.sin(roll / 2), w=math.cos(roll / 2)))
    sketch = sketch_runway((-500.0, 0.0, 50.0), turn, 45.0)
    ((x1, y1, x2, y2),) = by_color(sketch, 'accent')
    # From left to right the horizon rises (y is down).
    assert math.degrees(math.atan2(y2 - y1, x2 - x1)) == pytest.approx(-20.0, abs=0.1)
    assert dict(sketch.numbers)['roll'] == '20.0°'


def test_above_the_runway_it_is_drawn_as_far_as_it_lies_ahead():
    sketch = sketch_runway((700.0, 5.0, 30.0), LEVEL, 45.0)
    assert len(sketch.segments) == 5
    assert np.isfinite([value for segment in sketch.segments for value in segment[1:]]).all()


def test_the_tankers_left_wing_is_on_the_left():
    sketch = sketch_tanker((1.0, 2.0, 80.0), AHEAD)
    (wing, stabilizer) = by_color(sketch, 'left')
    assert wing[2] < wing[0] and stabilizer[2] < stabilizer[0]
    assert dict(sketch.numbers)['ahead'] == '80.0 m' and dict(sketch.numbers)['roll'] == '0.0°'


@pytest.mark.parametrize('number', [math.nan, math.inf, 0.0, 1e308])
def test_what_is_no_pose_has_no_lines(number):
    turn = rotation_of(Quaternion(x=number, y=number, z=number, w=number))
    place = (number,) * 3
    for sketch in (sketch_tanker(place, turn), sketch_runway(place, turn, 0.0)):
        assert sketch.segments == ()

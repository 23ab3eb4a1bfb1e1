"""Which of several lines along a side is the runway's."""

import numpy as np
import pytest

from mvuav_ros.vision.approach.side_lines import Line, LineChoice

EDGE, MARKING, SHOULDER = -0.08, -0.26, 0.12


def side(**clearness):
    """Lines by their names, each as clear as said."""
    places = {'edge': EDGE, 'marking': MARKING, 'shoulder': SHOULDER}
    return [Line(places[name], places[name], value) for name, value in clearness.items()]


def frames(choice, left, right, count):
    """Show the same lines so many times; the last choice."""
    return [choice.choose((left, right)) for _ in range(count)][-1]


def test_the_clearer_line_over_many_frames_wins_whichever_one_frame_shows_clearer():
    rng = np.random.default_rng(4)
    choice, clearer = LineChoice(), 0
    for number in range(60):
        edge, marking = rng.normal((2.0, 1.3), 0.4)
        clearer += marking > edge
        chosen = choice.choose((side(edge=edge, marking=marking), side(edge=2.0)))
        if number >= 10:
            assert chosen[0].middle == EDGE
    assert clearer >= 3


def test_of_lines_alike_on_both_sides_the_outer_ones_are_the_shoulders():
    both = side(edge=3.0, shoulder=3.1)
    choice = LineChoice()
    left, right = frames(choice, both, both, 20)
    assert (left.middle, right.middle) == (EDGE, EDGE)
    assert choice.shoulders > 0.8


def test_two_lines_alike_on_one_side_alone_are_no_shoulders():
    choice = LineChoice()
    frames(choice, side(edge=2.0, marking=1.95), side(edge=2.0), 20)
    assert choice.shoulders == 0.0


def test_a_line_that_comes_into_sight_is_believed_after_some_frames():
    choice = LineChoice()
    frames(choice, side(marking=1.2), side(edge=2.0), 20)
    clear = side(edge=2.2, marking=1.2)
    chosen = [choice.choose((clear, side(edge=2.0)))[0].middle for _ in range(40)]
    assert chosen[:3] == [MARKING] * 3
    assert chosen[-3:] == [EDGE] * 3
    assert chosen == sorted(chosen)


def test_another_line_does_not_stand_in_for_one_that_a_frame_does_not_show():
    choice = LineChoice()
    frames(choice, side(edge=2.0, marking=1.2), side(edge=2.0), 20)
    assert choice.choose((side(marking=1.2), side(edge=2.0))) is None
    assert choice.choose((side(edge=2.0, marking=1.2), side(edge=2.0)))[0].middle == EDGE


@pytest.mark.parametrize('moved', [-0.05, 0.05])
def test_lines_are_known_again_after_the_camera_has_turned_a_little(moved):
    choice = LineChoice()
    frames(choice, side(edge=2.0, marking=1.2), side(edge=2.0), 20)
    turned = [Line(EDGE + moved, EDGE + moved, 1.0), Line(MARKING + moved, MARKING + moved, 1.6)]
    assert choice.choose((turned, side(edge=2.0)))[0].middle == EDGE + moved


def test_where_colour_shows_the_edge_a_far_line_is_not_it():
    choice = LineChoice()
    choice.expect((0.0, 0.0), colour=True)
    left, _ = frames(choice, side(edge=1.9, marking=2.0), side(edge=2.0), 10)
    assert left.middle == EDGE

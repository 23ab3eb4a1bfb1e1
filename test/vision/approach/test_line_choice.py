"""Which of several lines along a side is the runway's."""

import pytest

from mvuav_ros.vision.approach.side_lines import Line, choose
from mvuav_ros.vision.approach.tuning import LINES

EDGE, MARKING, SHOULDER = -0.08, -0.26, 0.12


def side(**clearness):
    """Lines by their names, each as clear as said."""
    places = {'edge': EDGE, 'marking': MARKING, 'shoulder': SHOULDER}
    return [Line(places[name], places[name], value) for name, value in clearness.items()]


def chosen(left, right, expected=(0.0, 0.0), cost=LINES.away_cost):
    """Places of the lines chosen."""
    lines = choose(left, right, expected, cost)
    return lines[0].middle, lines[1].middle


def test_a_fainter_line_is_a_marking_wherever_the_edge_is_expected():
    left, _ = chosen(side(edge=2.0, marking=1.3), side(edge=2.0), (MARKING, 0.0))
    assert left == EDGE


@pytest.mark.parametrize(('expected', 'found'), [(0.0, EDGE), (MARKING, MARKING)])
def test_of_lines_alike_the_one_near_where_the_edge_is_expected(expected, found):
    left, _ = chosen(side(edge=2.0, marking=2.0), side(edge=2.0), (expected, 0.0))
    assert left == found


def test_of_lines_alike_on_both_sides_the_outer_ones_are_the_shoulders():
    both = side(edge=3.0, shoulder=3.1)
    assert chosen(both, both) == (EDGE, EDGE)


def test_two_lines_alike_on_one_side_alone_are_no_shoulders():
    lines = side(edge=2.0, shoulder=2.05), side(edge=2.0)
    assert chosen(*lines, (SHOULDER, 0.0))[0] == SHOULDER


def test_where_colour_shows_the_edge_a_far_line_is_not_it():
    lines = side(edge=1.65, marking=2.0), side(edge=2.0)
    assert chosen(*lines)[0] == MARKING
    assert chosen(*lines, cost=LINES.away_from_colour_cost)[0] == EDGE

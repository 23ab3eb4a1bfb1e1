"""Which of several lines along a side is the runway's."""

from mvuav_ros.vision.approach.side_lines import Line, choose

EDGE, MARKING, SHOULDER = -0.08, -0.26, 0.12


def side(**clearness):
    """Lines by their names, each as clear as said."""
    places = {'edge': EDGE, 'marking': MARKING, 'shoulder': SHOULDER}
    return [Line(places[name], places[name], value) for name, value in clearness.items()]


def chosen(left, right):
    """Places of the lines chosen, and the shoulders."""
    lines, shoulders = choose(left, right)
    return lines[0].middle, lines[1].middle, shoulders


def test_a_fainter_line_is_a_marking():
    left, _, _ = chosen(side(edge=2.0, marking=1.3), side(edge=2.0))
    assert left == EDGE


def test_of_lines_alike_on_both_sides_the_outer_ones_are_the_shoulders():
    both = side(edge=3.0, shoulder=3.1)
    left, right, shoulders = chosen(both, both)
    assert (left, right) == (EDGE, EDGE)
    assert shoulders > 0.8


def test_two_lines_alike_on_one_side_alone_are_no_shoulders():
    assert chosen(side(edge=2.0, marking=1.95), side(edge=2.0))[2] == 0.0

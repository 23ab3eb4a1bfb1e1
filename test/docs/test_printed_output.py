"""The comparison of a page's outputs with what was printed."""

import pytest
from support.printed_output import difference, same_line


@pytest.mark.parametrize(
    ('shown', 'printed'),
    [
        ('roll 3.1 deg', 'roll 3.2 deg'),
        ('roll -0.00 deg', 'roll 0.01 deg'),
        ('62 % of the lines', '63 %   of the lines'),
        ('rms 1.50e-05 m', 'rms 1.52e-05 m'),
        ('latency 250 ms', 'latency 255 ms'),
        ('left_wing: … y 190.30', 'left_wing: DETECTED x 150.12 y 190.31'),
        ("{'lost': '98 %'}", "{'lost': '99 %'}"),
    ],
)
def test_numbers_may_differ_by_two_percent_or_one_in_the_last_digit(shown, printed):
    assert same_line(shown, printed)


@pytest.mark.parametrize(
    ('shown', 'printed'),
    [
        ('roll 3.1 deg', 'roll 3.3 deg'),
        ('roll 0.15 deg', 'roll nan deg'),
        ('62 % of the lines', '64 % of the lines'),
        ('5 of 5 markers', '4 of 5 markers'),
        ('640x480 mono8', '640x481 mono8'),
        ('flight_1.mcap', 'flight_2.mcap'),
        ('5 of 5 markers', '5 of 5 lights'),
        ('left_wing: … y 190.30', 'left_wing: DETECTED x 150.12 y 210.00'),
    ],
)
def test_other_numbers_counts_and_words_differ(shown, printed):
    assert not same_line(shown, printed)


def test_an_ellipsis_stands_for_any_lines():
    printed = 'one\ntwo\nthree\nfour\n'
    assert not difference('one\n…\nfour', printed)
    assert not difference('…\nthree\n…', printed)
    assert not difference('one\n…\ntwo\nthree\nfour\n…', printed)
    assert 'five' in difference('one\n…\nfive', printed)
    assert difference('…\ntwo\n…\none\n…', printed)


def test_without_an_ellipsis_all_lines_are_shown():
    assert not difference('one\n\ntwo', 'one\ntwo\n')
    assert 'not shown:\ntwo' in difference('one', 'one\ntwo\n')
    assert difference('two', 'one\ntwo\n')
    assert difference('one\n…\ntwo', 'one\ntwo\nthree\n')

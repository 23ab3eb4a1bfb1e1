"""What comes in through the panel's one door."""

import math
import time

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from mvuav_ros.panel import sanitized


@pytest.mark.parametrize(
    ('said', 'shown'),
    [
        ('plain words', 'plain words'),
        ('<b>bold</b>', '<b>bold</b>'),
        ('two\n\tlines\u2028more', 'two lines more'),
        ('\u202eturned\u202c\u200b\x00', 'turned'),
        ('\x1b[31mred', '[31mred'),
        ('Z' + '\u0300' * 99, 'Z\u0300\u0300'),
        ('\ud800lone', '\ufffdlone'),
        ('x' * 300, 'x' * 199 + '…'),
        (None, 'None'),
    ],
)
def test_words_are_one_visible_line(said, shown):
    assert sanitized.words(said) == shown
    assert len(sanitized.words(said)) <= sanitized.LONGEST_WORDS


def test_a_flood_costs_little():
    before = time.process_time()
    for letter in ('x', '\u200b', '\n', '\u0300'):
        sanitized.words(letter * 10_000_000)
    assert time.process_time() - before < 1.0


@pytest.mark.parametrize('said', ['', 'abc', 'nan', 'inf', '1e999', '²', '0x1', None])
def test_what_is_no_number_is_nan(said):
    assert math.isnan(sanitized.number(said)) and sanitized.fixed(said, 2) == '-'


def test_numbers_are_of_bounded_length():
    assert sanitized.fixed('2.345', 2) == '2.35' or sanitized.fixed('2.345', 2) == '2.34'
    assert len(sanitized.fixed('1e300', 2)) < 12


@pytest.mark.parametrize('name', ['/a', '/tanker/marker_tracker', 'image_raw'])
def test_ros_names_pass(name):
    assert sanitized.is_ros_name(name)


@pytest.mark.parametrize('name', ['', '/', '/a b', '/a/', '/<b>', '/1', '/a\n', '/é', 'a' * 300])
def test_other_names_do_not(name):
    assert not sanitized.is_ros_name(name)


def test_statuses_are_bounded_in_number_and_length():
    pairs = [KeyValue(key=f'k{n}', value='v' * 5000) for n in range(500)]
    message = DiagnosticArray(
        status=[DiagnosticStatus(name=f's{n}', values=pairs) for n in range(300)]
    )
    found = sanitized.statuses(message)
    assert len(found) == 100
    assert all(len(values) == 100 for values in found.values())
    assert all(len(value) <= 200 for values in found.values() for value in values.values())


def test_a_few_numbers_stay_numbers_and_other_lists_are_a_line():
    assert sanitized.parameter_value([0.0, -10.5, 3.0]) == (0.0, -10.5, 3.0)
    for items in ([1, 2], ['a', 'b'], [0.0] * 1000, [True, False]):
        line = sanitized.parameter_value(items)
        assert isinstance(line, str) and len(line) <= sanitized.LONGEST_WORDS


def test_values_of_a_file():
    given = {'a': 1, 'b': 'x', 'c': [1, 2.5], 'd': ['x'], 'e': {'f': 1}, 'g': None, 'h': [True]}
    given['i'] = 2**63 + 1
    taken = {name: sanitized.plain_value(value) for name, value in given.items()}
    nothing = dict.fromkeys('deghi')
    assert taken == {'a': 1, 'b': 'x', 'c': (1.0, 2.5), **nothing}


def test_a_file_may_be_as_long_as_is_said_and_no_longer(tmp_path):
    path = tmp_path / 'text'
    path.write_text('word')
    assert sanitized.file_text(path, 4) == 'word'
    with pytest.raises(OSError, match='more than 3 bytes'):
        sanitized.file_text(path, 3)

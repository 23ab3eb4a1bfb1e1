"""The prose rules find what they are for, and nothing in code."""

import pytest
from support.places import load_tool

prose = load_tool('check_prose')


LONG = 'one word ' * 20 + 'end.'


@pytest.mark.parametrize(
    ('text', 'lines'),
    [
        ('All is well.\n', []),
        ('First.\n\nWhat is lost is said as NaN.\n', [3]),
        (f'- one\n- {LONG}\n', [2]),
        ('A sentence\nwith the the word.\n', [1]),
        (f'```text\n{LONG} simply the the\n```\nGood.\n', []),
        ('Use `simply the the` here.\n', []),
        (f'| {LONG} |\n', []),
        ('| this is simply wrong |\n', [1]),
        (f'{"one word " * 10}. {"one word " * 10}.\n', []),
    ],
)
def test_what_is_found(text, lines):
    assert [line for line, _ in prose.problems(text)] == lines


def test_measurements_may_have_longer_sentences():
    assert list(prose.problems(LONG, 60)) == []


@pytest.mark.parametrize(
    ('source', 'lines'),
    [
        ('"""A module that tells something."""\n', [1]),
        ('x = 1  # the liveliest of them\n', [1]),
        ('def f():\n    """Do it.\n\n    In one surprise.\n    """\n', [4]),
        ('x = 1\n"""Upset by it."""\n', [2]),
        ('MOST_ROWS = 3\n', [1]),
        ('_FEWEST = 3\n', [1]),
        ('def all_as(x): ...\n', [1]),
        ('self._told_silence = True\n', [1]),
        ('"""Good.\n\n>>> told = 1\n"""\n', []),
        ('most_rows = 3\n', []),
        ('text = "the lights do not tell a pose"\n', []),
        ('tellurium = 1  # not a word of ours\n', []),
    ],
)
def test_what_is_found_in_source(source, lines):
    assert [line for line, _ in prose.source_problems(source)] == lines


def test_all_pages_are_looked_at(capsys):
    assert prose.main() == 0, capsys.readouterr().out

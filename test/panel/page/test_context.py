"""Undo and redo."""

import pytest

pytest.importorskip('nicegui', reason='the extra panel is not installed')

from mvuav_ros.panel.page.context import History


def test_the_last_change_is_taken_back_and_done_again():
    now = [0.0]
    history = History(lambda: now[0])
    assert history.undo() == {} and history.redo() == {}
    history.record({'a': 1}, {'a': 2})
    now[0] = 5.0
    history.record({'b': 1}, {'b': 9})
    assert history.undo() == {'b': 1} and history.undo() == {'a': 1} and history.undo() == {}
    assert history.redo() == {'a': 2} and history.undone
    history.record({'c': 0}, {'c': 1})
    assert not history.undone and history.undo() == {'c': 0}


def test_one_movement_of_a_slider_is_one_step():
    now = [0.0]
    history = History(lambda: now[0])
    for value in range(10):
        now[0] += 0.2
        history.record({'a': value}, {'a': value + 1})
    now[0] += 3.0
    history.record({'a': 10}, {'a': 50})
    assert history.undo() == {'a': 10} and history.undo() == {'a': 0} and not history.done


def test_a_change_to_the_same_is_none():
    history = History()
    history.record({'a': 1}, {'a': 1})
    assert not history.done

"""Undo and redo, and what else the parts of a page share."""

import asyncio
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest

pytest.importorskip('nicegui', reason='the extra panel is not installed')

from mvuav_ros.messages.sensors import type_name
from mvuav_ros.panel import live_nodes, node_recorder
from mvuav_ros.panel.page import elements
from mvuav_ros.panel.page.context import History
from mvuav_ros.panel.page.parameters import Parameters
from mvuav_ros.panel.page.set_bar import SetBar
from mvuav_ros.panel.page.tiles import value_at
from mvuav_ros.panel.page.view import PanelView
from mvuav_ros.panel.sets import SetStore
from mvuav_ros.vision.image import Image


def test_the_last_change_is_taken_back_and_done_again():
    now = [0.0]
    history = History(lambda: now[0])
    assert history.step(back=True) == {} and history.step(back=False) == {}
    history.record({'a': 1}, {'a': 2})
    now[0] = 5.0
    history.record({'b': 1}, {'b': 9})
    assert (
        history.step(back=True) == {'b': 1}
        and history.step(back=True) == {'a': 1}
        and history.step(back=True) == {}
    )
    assert history.step(back=False) == {'a': 2} and history.undone
    history.record({'c': 0}, {'c': 1})
    assert not history.undone and history.step(back=True) == {'c': 0}


def test_one_movement_of_a_slider_is_one_step():
    now = [0.0]
    history = History(lambda: now[0])
    for value in range(10):
        now[0] += 0.2
        history.record({'a': value}, {'a': value + 1})
    now[0] += 3.0
    history.record({'a': 10}, {'a': 50})
    assert (
        history.step(back=True) == {'a': 10}
        and history.step(back=True) == {'a': 0}
        and not history.done
    )


def test_a_movement_there_and_back_is_no_step():
    now = [5.0]
    history = History(lambda: now[0])
    history.record({'a': False}, {'a': True})
    now[0] += 3.0
    for before in (True, False, True):
        now[0] += 0.2
        history.record({'a': before}, {'a': not before})
    assert (
        history.step(back=True) == {'a': True}
        and history.step(back=True) == {'a': False}
        and not history.done
    )


def test_a_change_to_the_same_is_none():
    history = History()
    history.record({'a': 1}, {'a': 1})
    assert not history.done


def test_what_the_node_refuses_to_take_back_can_be_tried_again():
    asked, answers = [], [{'a': 'the node is gone'}, {}, {'a': 'no'}, {}]

    async def answer(values, *, undoable):
        asked.append(dict(values))
        return answers.pop(0)

    page = SimpleNamespace(_history=History(), _set=answer, _count_edits=lambda: None)
    page._history.record({'a': 1}, {'a': 2})
    for back in (True, True, False, False):
        asyncio.run(Parameters.step(page, back=back))
    assert asked == [{'a': 1}, {'a': 1}, {'a': 2}, {'a': 2}]
    assert page._history.done == [({'a': 1}, {'a': 2})] and not page._history.undone


def test_a_set_that_cannot_be_deleted_is_named_with_the_reason(tmp_path, monkeypatch):
    said, listed = [], []

    async def confirmed(question, yes):
        return True

    monkeypatch.setattr(elements, 'confirmed', confirmed)
    monkeypatch.setattr(elements, 'notify', lambda words, bad: said.append(words))
    (tmp_path / 'night.yaml').mkdir()
    bar = SetBar.__new__(SetBar)
    services = SimpleNamespace(
        sets=SetStore(tmp_path), sets_changed=SimpleNamespace(emit=lambda: listed.append(1))
    )
    bar._page = SimpleNamespace(chosen_set='night', services=services)
    asyncio.run(bar._delete_chosen())
    (words,) = said
    assert 'night.yaml' in words and listed


def test_a_name_in_a_set_that_the_node_has_not_is_said():
    bar = SetBar.__new__(SetBar)
    bar._page, bar._match = SimpleNamespace(chosen_set='night'), MagicMock()
    values = {'threshold': 0.7, 'min_area': 1}
    bar._node = SimpleNamespace(values=values, own_values=values)
    said = {}
    for bar.values in ({'threshold': 0.7}, {'threshold': 0.7, 'thresold': 0.6}):
        assert bar.compare() == {}
        said[tuple(bar.values)] = bar._match.set_text.call_args.args[0]
    plain, misspelt = said.values()
    assert 'thresold' not in plain and 'The node has no thresold' in misspelt


def test_a_pixel_is_seen_in_the_nodes_channel():
    pixels = np.zeros((2, 3, 3), np.uint8)
    pixels[1, 2] = 0, 0, 255
    image = Image(pixels, 'bgr8')
    seen = {channel: value_at(image, 2, 1, channel) for channel in ('red', 'blue', 'brightest')}
    assert seen == {'red': 1.0, 'blue': 0.0, 'brightest': 1.0}
    assert (
        value_at(image, 2, 1, 'auto')
        == value_at(image, 2, 1, None)
        == pytest.approx(0.298, abs=1e-3)
    )


def test_a_recording_has_all_that_the_node_listens_to():
    kinds = {
        '/imu/data': 'sensor_msgs/msg/Imu',
        '/left/info': 'sensor_msgs/msg/CameraInfo',
        '/left/image': 'sensor_msgs/msg/Image',
    }
    topics = live_nodes._input([(topic, [kind]) for topic, kind in kinds.items()])
    assert topics == ('/left/image', False, '/left/info', '/imu/data')
    results = [
        ('/eye/marker/beacon', 'geometry_msgs/msg/PointStamped'),
        ('/eye/debug_image', 'sensor_msgs/msg/Image'),
    ]
    found = live_nodes.FoundNode('/eye', 'marker_tracker', *topics, frozenset(), tuple(results))
    node = live_nodes.LiveNode.__new__(live_nodes.LiveNode)
    node.found, node.status, node.name, node.kind = found, {}, '/eye', 'marker_tracker'
    recorded = node_recorder._topics(node)
    assert {topic: type_name(recorded[topic]) for topic in kinds} == kinds
    assert type_name(recorded['/eye/marker/beacon']) == 'geometry_msgs/msg/PointStamped'
    assert '/eye/debug_image' not in recorded
    assert live_nodes._input([]) == ('', False, '', '')


def test_the_page_drops_what_it_has_of_a_node_that_is_forgotten():
    """Those of other nodes stay as they are, for what is clicked before they are off the screen."""

    class Place(list):
        def add(self, name):
            self.append(SimpleNamespace(props={'name': name}, delete=lambda: self.drop(name)))

        def drop(self, name):
            self[:] = [each for each in self if each.props['name'] != name]

        @property
        def names(self):
            return [each.props['name'] for each in self]

    nodes = {name: SimpleNamespace(name=name, controls=[]) for name in ('/one', '/two')}
    view, made = PanelView.__new__(PanelView), []
    view._page = SimpleNamespace(services=SimpleNamespace(system=SimpleNamespace(nodes=nodes)))
    view._parts, view._results_of, view._parameters_of = {}, Place(), Place()

    def make(name, node):
        made.append(name)
        view._results_of.add(name)
        return name, SimpleNamespace(show=lambda: None)

    view._make_parts = make
    for name in ('/one', '/two', '/one'):
        view._show_parts(nodes[name])
        assert (view._results, view._results_of.value) == (name, name)
    assert made == view._results_of.names == ['/one', '/two']
    nodes['/one'].controls.append('threshold')
    view._show_parts(nodes['/one'])
    assert made == ['/one', '/two', '/one'] and view._results_of.names == ['/two', '/one']
    gone = nodes.pop('/two')
    view._show_parts(nodes['/one'])
    assert view._results_of.names == ['/one'] and '/two' not in view._parts
    nodes['/two'] = gone
    view._show_parts(gone)
    assert made[3:] == ['/two'] and view._results_of.names == ['/one', '/two']

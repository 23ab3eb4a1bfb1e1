"""A recording on a page, frame by frame."""

import asyncio
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

pytest.importorskip('nicegui', reason='the extra panel is not installed')

from mvuav_ros.panel.page import elements, run_list
from mvuav_ros.panel.page.playback import Frames, _Topics
from mvuav_ros.panel.page.run_list import Runs
from mvuav_ros.panel.runs import RunStore
from mvuav_ros.panel.sanitized import NameRefusedError


def test_nothing_of_one_recording_stands_under_the_name_of_another():
    chosen, lane, filled = ['first.mcap'], MagicMock(), []
    frames = Frames.__new__(Frames)
    node = SimpleNamespace(
        kind='marker_tracker', controls=['threshold'], own_values={}, image_topic=''
    )
    node.found, node.camera_info_topic = SimpleNamespace(imu_topic=''), ''
    topics = MagicMock(used='')
    frames._page, frames._recording = SimpleNamespace(node=node), lambda: chosen[0]
    frames._set, frames._from = SimpleNamespace(value=''), SimpleNamespace(value=0.0)
    frames._words, frames._differing = MagicMock(is_deleted=False), MagicMock()
    frames._lanes, frames._visible = [lane], False
    frames._menus = [topics] * 3
    frames._index, frames._count = 80, 180
    frames._fill = lambda shown, name: filled.append(shown.source)

    class Process:
        async def show(self, wanted):
            asked = wanted.source
            if asked == 'first.mcap':
                chosen[0] = 'second.mcap'
                frames.rewind()
            return SimpleNamespace(source=asked, lost='')

    frames._process = Process()
    for _ in range(2):
        asyncio.run(frames._show_one())
    assert filled == ['second.mcap'] and (frames._index, frames._count) == (0, 1)
    # What was on the screen went when the other one was chosen.
    lane.show.assert_called_once_with('', None)


def test_topics_are_offered_where_there_is_something_to_choose(monkeypatch):
    menu, chosen = MagicMock(options={}), []
    menu.set_options = lambda options, value: setattr(menu, 'options', options)
    monkeypatch.setattr(elements, 'choice', lambda *_, **__: menu)
    topics = _Topics('Attitude', lambda: chosen.append(topics.used))

    def is_offered(shown, there):
        topics.fill(shown, there)
        assert [*menu.options] == there
        return menu.set_visibility.call_args.args[0]

    own = '/mavros/imu/data'
    assert not is_offered('', []) and not is_offered('/imu', ['/imu'])
    assert is_offered('/imu', ['/imu', own]) and is_offered('', [own])
    topics._choose(SimpleNamespace(value=own))
    assert chosen == [own] and not is_offered(own, [own])
    # What the page itself sets is no choice.
    topics._choose(SimpleNamespace(value=own))
    assert chosen == [own]
    topics.forget()
    assert topics.used == ''


def test_the_calibration_that_a_node_listens_to_goes_with_its_images_alone():
    node = SimpleNamespace(image_topic='/left/image_raw', camera_info_topic='/rig/left_info')
    node.found = SimpleNamespace(imu_topic='/mavros/imu/data')
    frames = Frames.__new__(Frames)
    frames._page, frames.show = SimpleNamespace(node=node), MagicMock()
    images, calibration, attitude = frames._menus = [MagicMock(used='') for _ in range(3)]
    assert frames.topics(node) == ('/left/image_raw', '/rig/left_info', '/mavros/imu/data')
    images.used, calibration.used = '/left/image_raw', '/rig/info'
    assert frames.topics(node) == ('/left/image_raw', '/rig/info', '/mavros/imu/data')
    # The choice of other images forgets it.
    images.used, calibration.used = '/right/image_raw', ''
    assert frames.topics(node) == ('/right/image_raw', '', '/mavros/imu/data')
    frames._show_other_images()
    assert calibration.forget.called and attitude.forget.called and frames.show.called
    assert not images.forget.called


def test_each_node_keeps_the_recording_that_was_chosen_for_it():
    def page(kept, selected):
        runs = Runs.__new__(Runs)
        node = SimpleNamespace(kind='marker_tracker')
        runs._page = SimpleNamespace(kept=kept, selected=selected, node=node)
        runs._bags = dict.fromkeys(('tanker.mcap', 'flight.mcap', 'landing.mcap'))
        runs._bag, runs.frames = SimpleNamespace(value=None), MagicMock()
        runs.choose_recording()
        return runs

    kept = {'recordings': {}}
    here = page(kept, '/tracker')
    assert here._bag.value == 'tanker.mcap'
    here._bag.value = 'landing.mcap'
    here._opened()
    assert page(kept, '/other')._bag.value == 'tanker.mcap'
    assert page(kept, '/tracker')._bag.value == 'landing.mcap'


def test_a_run_that_is_refused_leaves_the_set_of_its_name_alone(tmp_path, monkeypatch):
    saved, said = [], []

    def save_set(page, node, name):
        if name == 'default':
            raise NameRefusedError('default is part of the package')
        saved.append(name)

    monkeypatch.setattr(run_list, 'save_set', save_set)
    monkeypatch.setattr(elements, 'notify', lambda words, bad: said.append(words))
    store = RunStore(tmp_path)
    (tmp_path / 'night').mkdir()
    runs = Runs.__new__(Runs)
    runs._page = SimpleNamespace(
        node=SimpleNamespace(controls=['threshold']), services=SimpleNamespace(runs=store)
    )
    runs._runner, runs._bags = SimpleNamespace(is_busy=False), {'flight.mcap': tmp_path}
    runs._bag, runs._name = SimpleNamespace(value='flight.mcap'), SimpleNamespace()
    for runs._name.value in ('night', 'default'):
        asyncio.run(runs._run(as_set=True))
    assert said == ['there is a run night already', 'default is part of the package']
    assert saved == [] and [path.name for path in tmp_path.iterdir()] == ['night']

"""A recording on a page, frame by frame."""

import asyncio
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

pytest.importorskip('nicegui', reason='the extra panel is not installed')

from mvuav_ros.panel.page.playback import Frames
from mvuav_ros.panel.page.run_list import Runs


def test_nothing_of_one_recording_stands_under_the_name_of_another():
    chosen, lane, filled = ['first.mcap'], MagicMock(), []
    frames = Frames.__new__(Frames)
    node = SimpleNamespace(
        kind='marker_tracker', controls=['threshold'], own_values={}, image_topic=''
    )
    frames._page, frames._recording = SimpleNamespace(node=node), lambda: chosen[0]
    frames._set, frames._from = SimpleNamespace(value=''), SimpleNamespace(value=0.0)
    frames._words, frames._differing = MagicMock(is_deleted=False), MagicMock()
    frames._lanes, frames._visible, frames._wanted = [lane], False, ''
    frames._index, frames._count = 80, 180
    frames._fill = lambda shown, name: filled.append(shown)

    class Process:
        async def show(self, wanted):
            asked = wanted.source
            if asked == 'first.mcap':
                chosen[0] = 'second.mcap'
                frames.rewind()
            return asked

    frames._process = Process()
    for _ in range(2):
        asyncio.run(frames._show_one())
    assert filled == ['second.mcap'] and (frames._index, frames._count) == (0, 1)
    # What was on the screen went when the other one was chosen.
    lane.show.assert_called_once_with('', None)


def test_each_node_keeps_the_recording_that_was_chosen_for_it():
    def page(kept, selected):
        runs = Runs.__new__(Runs)
        node = SimpleNamespace(kind='marker_tracker')
        runs._page = SimpleNamespace(kept=kept, selected=selected, node=node)
        runs._bags = dict.fromkeys(('tanker.mcap', 'flight.mcap', 'landing.mcap'))
        runs._bag, runs.frames = SimpleNamespace(value=None), MagicMock()
        runs.choose_recording()
        return runs

    kept = {}
    here = page(kept, '/tracker')
    assert here._bag.value == 'tanker.mcap'
    here._bag.value = 'landing.mcap'
    here._opened()
    assert page(kept, '/other')._bag.value == 'tanker.mcap'
    assert page(kept, '/tracker')._bag.value == 'landing.mcap'

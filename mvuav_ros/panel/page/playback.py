"""A recording frame by frame, with the node's values of now, and beside them those of a set."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from nicegui import background_tasks, ui

from mvuav_ros.panel import sanitized
from mvuav_ros.panel.controls import value_text
from mvuav_ros.panel.live_nodes import LiveNode
from mvuav_ros.panel.page import elements as el
from mvuav_ros.panel.page.context import Page
from mvuav_ros.panel.reel import ReelFailedError, ReelProcess, Result, Shown, Wanted, settable
from mvuav_ros.panel.sanitized import NameRefusedError
from mvuav_ros.panel.sets import differences
from mvuav_ros.parameters.declaration import ParameterError

_PLAYING_INTERVAL = 0.1
_LIVE = 'live values'


class Frames:
    """The frame on the screen follows the sliders; ``recording`` gives the one chosen, if any.

    Its `topics` are those by which it is read.
    """

    def __init__(self, page: Page, recording: Callable[[], Path | None]) -> None:
        self._page, self._recording = page, recording
        self._process = ReelProcess()
        self._visible = self._busy = self._due = False
        self._index, self._count = 0, 1
        with el.box('form'):
            with el.box('line wrap'):
                el.icon_button('skip_previous', 'One frame back', lambda: self.step(-1))
                self._play = el.icon_button('play_arrow', 'Play', self.play)
                el.icon_button('skip_next', 'One frame on', lambda: self.step(1))
                self._slider = el.slider('Frame', self._go).props('max=0').classes('grow')
                self._words = el.text('', 'small soft number').props('role=status')
            with el.box('line wrap'):
                self._menus = [_Topics('Images', self._show_other_images)]
                self._menus += [_Topics(each, self.show) for each in ('Calibration', 'Attitude')]
                self._from = ui.number('From [s]', value=0.0, min=0.0, on_change=self._begin)
                self._from.props('outlined dense debounce=500').style('width: 110px')
                self._set = el.choice({'': 'nothing'}, 'Compare with', '', on_change=self.show)
                self._set.classes('grow').style('min-width: 160px')
            self._differing = el.text('', 'small soft breaks')
        with el.box('lanes'):
            self._lanes = [_ResultView(), _ResultView()]
        self._timer = ui.timer(_PLAYING_INTERVAL, self._next, active=False)
        ui.context.client.on_delete(self._process.end)
        self.reload_sets()

    def follow_node(self) -> None:
        """After another node was selected: its sets, and the images that it listens to."""
        self._forget_topics()
        self.reload_sets()

    def reload_sets(self) -> None:
        """After sets were saved or deleted."""
        node = self._page.node
        names = self._page.services.sets.names(node.kind) if node else []
        chosen = self._set.value if self._set.value in names else ''
        self._set.set_options({'': 'nothing', **{name: name for name in names}}, value=chosen)
        self.show()

    def appear(self, visible: bool) -> None:
        """Only what is on the screen is processed."""
        self._visible = visible
        self._set_playing(False)
        self.show()

    def rewind(self) -> None:
        """After another recording was chosen."""
        self._forget_topics()
        self._from.value = 0.0
        self._begin()

    def topics(self, node: LiveNode) -> tuple[str, str, str]:
        """Of images, calibration and attitude, see `BagImages`: those in use, else the node's."""
        images, calibration, attitude = (menu.used for menu in self._menus)
        if images in ('', node.image_topic):
            images, calibration = node.image_topic, calibration or node.camera_info_topic
        return images, calibration, attitude or node.found.imu_topic

    def _forget_topics(self, first: int = 0) -> None:
        for menu in self._menus[first:]:
            menu.forget()

    def _show_other_images(self) -> None:
        # What belonged to those before is not theirs.
        self._forget_topics(1)
        self.show()

    def _begin(self) -> None:
        """Go to the first frame of a stretch; until it is opened nothing stands under its name."""
        self._index, self._count = 0, 1
        self._clear('')
        self.show()

    def step(self, frames: int) -> None:
        """Go so many frames on."""
        self._set_playing(False)
        self._go(self._index + frames)

    def play(self) -> None:
        """Play, or pause."""
        self._set_playing(not self._timer.active)

    def show(self) -> None:
        """Process the frame again: values, set, recording or place have changed."""
        self._due = True
        if self._visible and not self._busy:
            background_tasks.create(self._work())

    def _set_playing(self, on: bool) -> None:
        self._timer.active = on
        self._play.set_icon('pause' if on else 'play_arrow')
        el.set_props(self._play, aria_label='Pause playing' if on else 'Play')

    def _next(self) -> None:
        if not self._busy:
            self._go((self._index + 1) % self._count)

    def _go(self, index: int) -> None:
        self._index = max(index, 0)
        self.show()

    async def _work(self) -> None:
        """One frame after the other, and always the newest that is wanted."""
        self._busy = True
        try:
            while self._due and self._visible and not self._words.is_deleted:
                self._due = False
                await self._show_one()
        finally:
            self._busy = False

    async def _show_one(self) -> None:
        node, path, name = self._page.node, self._recording(), str(self._set.value or '')
        if path is None:
            self._clear('No recording yet: record one, or start tuning_panel with --bags.')
        if node is None or path is None or not node.controls:
            return
        live = node.own_values
        sets, reason = [live], ''
        if name:
            try:
                sets.append({**live, **self._page.services.sets.load(name, node.kind)})
            except (NameRefusedError, ParameterError, OSError) as error:
                name, reason = '', str(error)
        values = tuple(settable(node.kind, each) for each in sets)
        stretch = str(path), max(self._from.value or 0.0, 0.0), node.kind, self._index
        wanted = Wanted(*stretch, values, self.topics(node))
        if self._count == 1:
            self._words.set_text('opening …')
        shown, failure = None, ''
        try:
            shown = await self._process.show(wanted)
        except ReelFailedError as error:
            failure = sanitized.words(error)
        there = self._page.node, self._recording()
        if self._words.is_deleted or (node, path) != there or self.topics(node) != wanted.topics:
            # Of what was chosen before.
            self._due = True
            return
        if shown is None:
            self._set_playing(False)
            self._clear(failure)
            return
        self._fill(shown, name)
        found = differences(values[0], values[-1])
        said = (f'{n} {value_text(own)} | {value_text(its)}' for n, (own, its) in found.items())
        words = f'{_LIVE} | {name}: {", ".join(said) or "no parameter differs"}'
        notes = filter(None, (shown.lost, words if name else reason))
        self._differing.set_text(sanitized.words('; '.join(notes), sanitized.LONGEST_DESCRIPTION))

    def _clear(self, words: str) -> None:
        self._words.set_text(words)
        self._differing.set_text('')
        for lane in self._lanes:
            lane.show('', None)

    def _fill(self, shown: Shown, name: str) -> None:
        self._count = shown.count
        self._index = min(self._index, shown.count - 1)
        for menu, topics in zip(self._menus, shown.topics, strict=False):
            menu.fill(*topics)
        el.set_props(self._slider, max=shown.count - 1, data_index=str(shown.index))
        part = '' if shown.is_whole else ' (a part)'
        self._words.set_text(
            f'frame {shown.index + 1} of {shown.count}{part} · {shown.seconds:.2f} s'
        )
        titles = (_LIVE, name)
        for lane, title, result in zip(self._lanes, titles, (*shown.results, None), strict=False):
            lane.show(title, result)


class _Topics:
    """A menu of a recording's topics of one kind, on the page where there is something to choose.

    ``used`` is the one in use, or the one that the user chose; empty if there is none.
    """

    def __init__(self, label: str, on_choose: Callable[[], None]) -> None:
        self._on_choose = on_choose
        self._menu = el.choice({}, label, on_change=self._choose)
        self._menu.classes('grow').style('min-width: 160px')
        self.forget()

    def forget(self) -> None:
        """Before another recording is opened, or one is read for another node."""
        self.used = ''
        self._menu.set_visibility(False)

    def fill(self, used: str, topics: Sequence[str]) -> None:
        """What a recording has, and which of it is in use."""
        self.used = used
        if (self._menu.value or '', [*self._menu.options]) != (used, [*topics]):
            self._menu.set_options({t: sanitized.words(t) for t in topics}, value=used or None)
        self._menu.set_visibility(not {*topics} <= {used})

    def _choose(self, event: Any) -> None:
        if event.value not in (None, self.used):
            self.used = event.value
            self._on_choose()


class _ResultView:
    """One of the two images, with its figures."""

    def __init__(self) -> None:
        with el.box('lane') as self._whole:
            self._title = el.text('', 'title')
            with el.box('well'):
                self._image = el.box('still', 'img')
            self._trust = el.text('', 'trust')
            self._figures = el.sheet('Figures of the frame', ('', '', ''))
        self._whole.set_visibility(False)

    def show(self, title: str, result: Result | None) -> None:
        """What a set of values made of the frame; nothing where there is no such set."""
        self._whole.set_visibility(result is not None)
        if result is None:
            return
        self._title.set_text(sanitized.words(title))
        self._image.set_visibility(bool(result.jpeg))
        if result.jpeg:
            source = f'data:image/jpeg;base64,{base64.b64encode(result.jpeg).decode()}'
            el.set_props(self._image, src=source, alt=f'Result with {title}')
        state, words = result.said.get('trust', ('bad', ''))
        self._trust.set_text(sanitized.words(result.reason or words))
        el.set_props(self._trust, data_trust='bad' if result.reason else state)
        el.fill(self._figures, result.said.get('figures', []))

"""The part with the images, chosen and arranged by the user."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial

from nicegui import ui

from mvuav_ros.panel import foreign
from mvuav_ros.panel.images import INPUT, RESULT_OF_KIND, Stream, streams_of
from mvuav_ros.panel.live_socket import MOST_STREAMS
from mvuav_ros.panel.page.context import Page
from mvuav_ros.panel.page.elements import box, button, empty, errors_told, tell, text
from mvuav_ros.panel.page.tile import Tile
from mvuav_ros.panel.recorder import Recorder
from mvuav_ros.parameters.declaration import Value
from mvuav_ros.recordings.errors import RecordingError

_SIZES = ('s', 'm', 'l')
_KEPT = 'tuning_panel_images'
Wish = tuple[str, str]
"""A stream's key and a size."""


class Images:
    """The tiles; a click on one calls ``set_parameter`` with node, parameter and value."""

    def __init__(self, page: Page, set_parameter: Callable[[str, str, Value], None]) -> None:
        self.page, self.set_parameter = page, set_parameter
        self._tiles: list[Tile] = []
        self._wished: list[Wish] = []
        self._recorder: Recorder | None = None
        with box('part images'):
            with box('bar'):
                button('All windows', lambda: self._wish([]), 'grid_view')
                button('Raw and result', lambda: self._wish(self._usual(pair=True)), 'compare')
                with button('Add image', lambda: None, 'add'):
                    self._menu = ui.menu().on('before-show', self._offer)
                self._record = button('Record', self._toggle_recording, 'fiber_manual_record')
                self._words = text('', 'small soft grow').props('role=status')
            self._grid = box('tiles')
            with box('card') as self._empty:
                empty('No image chosen', 'Add one with the buttons above.')

    async def restore(self) -> None:
        """Take the arrangement that the browser has kept; on a slow link the usual will do."""
        with suppress(TimeoutError, TypeError, ValueError, RecursionError):
            script = f'return localStorage.getItem({json.dumps(_KEPT)})'
            kept = json.loads(await ui.run_javascript(script, timeout=10.0))
            wishes = [(str(key), str(size)) for key, size in kept][:MOST_STREAMS]
            self._wished = [wish for wish in wishes if wish[1] in _SIZES]
            self.refresh()

    def _streams(self) -> dict[str, Stream]:
        nodes = self.page.services.system.nodes.values()
        return {stream.key: stream for node in nodes for stream in streams_of(node)}

    def refresh(self) -> None:
        """After nodes came or went, or another was selected."""
        streams = self._streams()
        wishes = [wish for wish in self._wished if wish[0] in streams] or self._usual()
        if wishes != self._shown():
            self._grid.clear()
            with self._grid:
                self._tiles = [Tile(streams[key], self, size) for key, size in wishes]
        self._empty.set_visibility(not self._tiles)

    def _usual(self, *, pair: bool = False) -> list[Wish]:
        """The selected node's images: the thesis's five windows, or input and result."""
        node = self.page.node
        if node is None:
            return []
        large = (INPUT, RESULT_OF_KIND[node.kind])
        streams = [stream for stream in streams_of(node) if stream.name in large or not pair]
        streams.sort(key=lambda stream: stream.name not in large)
        return [(stream.key, 'm' if stream.name in large else 's') for stream in streams]

    def _shown(self) -> list[Wish]:
        return [(tile.stream.key, tile.size) for tile in self._tiles]

    def _wish(self, wishes: list[Wish]) -> None:
        """Show these, on the next visit too; none: the usual ones of whatever node is selected."""
        self._wished = wishes
        self.refresh()
        kept = json.dumps(wishes)
        ui.run_javascript(f'localStorage.setItem({json.dumps(_KEPT)}, {json.dumps(kept)})')

    def rearrange(self, tile: Tile, what: str) -> None:
        """Show a tile no more, at another place, or in the next size: third, half, whole width."""
        wishes, place = self._shown(), self._tiles.index(tile)
        key, size = wishes.pop(place)
        if what == 'size':
            wishes.insert(place, (key, _SIZES[(_SIZES.index(size) + 1) % len(_SIZES)]))
        elif what in ('forward', 'back'):
            wishes.insert(max(place + (1 if what == 'back' else -1), 0), (key, size))
        self._wish(wishes)

    def _offer(self) -> None:
        shown = {tile.stream.key for tile in self._tiles}
        offered = [stream for key, stream in self._streams().items() if key not in shown]
        self._menu.clear()
        with self._menu:
            for stream in offered:
                ui.menu_item(f'{stream.title} of {stream.node}', partial(self._add, stream.key))
            if not offered:
                text('All are shown' if shown else 'No node yet', 'q-pa-sm soft')

    def _add(self, key: str) -> None:
        if len(self._tiles) >= MOST_STREAMS:
            tell(f'At most {MOST_STREAMS} images can be shown.', bad=True)
            return
        self._wish([*self._shown(), (key, 'm')])

    def show_values(self) -> None:
        """After a node's values changed."""
        for tile in self._tiles:
            tile.show_values()

    def _toggle_recording(self) -> None:
        node, services = self.page.node, self.page.services
        if self._recorder is not None:
            self.stop_recording()
        elif node is None:
            tell('There is no node to record.', bad=True)
        else:
            name = f'{node.kind} {time.strftime("%Y-%m-%d %H.%M.%S")}.mcap'
            with errors_told():
                self._recorder = Recorder(services.ros, node, services.recordings / name)
            self.show_recording()

    def show_recording(self) -> None:
        """How far the recording is."""
        recorder = self._recorder
        self._record.set_text('Stop' if recorder else 'Record')
        if recorder is not None:
            words = f'{recorder.messages} messages, {recorder.seconds:.0f} s'
            self._words.set_text(f'Recording {recorder.path.name}: {words}')

    def stop_recording(self) -> None:
        """End it, also when the page is closed."""
        recorder, self._recorder = self._recorder, None
        if recorder is None:
            return
        try:
            recorder.stop()
            said = f'Recorded {recorder.messages} messages: {recorder.path}'
        except RecordingError as error:
            said = str(error)
        if not self._words.is_deleted:
            self._words.set_text(foreign.words(f'{said} {recorder.error}'))
            self.show_recording()
        self.page.services.runs_changed.emit()

"""The part with the images, chosen and arranged by the user."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from nicegui import ui

from mvuav_ros.panel import foreign
from mvuav_ros.panel.images import RESULT_OF_KIND, Stream, encode_png, streams_of
from mvuav_ros.panel.live_socket import MOST_STREAMS
from mvuav_ros.panel.page.context import Page
from mvuav_ros.panel.page.elements import box, button, empty, icon_button, set_prop, tell, text
from mvuav_ros.panel.recorder import Recorder
from mvuav_ros.parameters.declaration import Value
from mvuav_ros.recordings.errors import RecordingError
from mvuav_ros.vision.image import Image, ImageError

_SIZES = ('s', 'm', 'l')
_KEPT = 'tuning_panel_images'
_INPUT = 'input'
KEPT_ARRANGEMENT = f'return localStorage.getItem({json.dumps(_KEPT)})'
"""JavaScript for `Images.restore`."""
SHOW_VALUE, THRESHOLD, START_ROW, END_ROW = 'Value', 'threshold', 'start_row', 'end_row'
_ACTIONS = {THRESHOLD: 'Threshold', START_ROW: 'Start row', END_ROW: 'End row'}
Wish = tuple[str, str]
"""A stream's key and a size."""


class Tile:
    """One image."""

    def __init__(self, stream: Stream, part: Images, size: str) -> None:
        self.stream, self.size, self._part = stream, size, part
        self._action = SHOW_VALUE
        self._actions: dict[str, str] = {}
        with box(f'card tile {size}', 'article') as self.element:
            self.element.props['aria-label'] = f'{stream.title} of {stream.node}'
            with box('tile-head'):
                text(stream.title, 'title')
                text(stream.node, 'soft small grow title')
                text('', 'rate number small soft')
                icon_button('chevron_left', 'Move to the front', lambda: part.move(self, -1))
                icon_button('chevron_right', 'Move to the back', lambda: part.move(self, 1))
                icon_button('photo_size_select_large', 'Another size', lambda: part.resize(self))
                icon_button('photo_camera', 'Save this image as PNG', self._snapshot)
                icon_button('close', 'Remove', lambda: part.remove(self))
            with box('well').props('data-fresh=never'):
                self._canvas = box('image', 'canvas').props('role=img')
                self._canvas.props['data-key'] = stream.key
                self._canvas.props['aria-label'] = stream.title
                text('Waiting for images', 'waiting')
            if stream.name == _INPUT:
                self._canvas.classes('clickable')
                self._canvas.on('pixel', self._clicked, ['detail'])
                self._foot = box('tile-foot')
        self.show_values()

    @property
    def _values(self) -> dict[str, Any]:
        node = self._part.page.services.system.nodes.get(self.stream.node)
        if node is None:
            return {}
        counting = {control.name for control in node.controls if control.counts(node.values)}
        return {name: value for name, value in node.values.items() if name in counting}

    def show_values(self) -> None:
        """Follow the node's values: the rows searched, and what a click can set."""
        if self.stream.name != _INPUT:
            return
        values = self._values
        rows = [values.get(name) for name in (START_ROW, END_ROW)]
        shown = ','.join(map(str, rows)) if None not in rows else ''
        set_prop(self._canvas, 'data-rows', shown)
        actions = {key: words for key, words in _ACTIONS.items() if key in values}
        if actions != self._actions or not self._foot.default_slot.children:
            self._actions = actions
            self._foot.clear()
            with self._foot:
                self._make_foot(actions)

    def _make_foot(self, actions: dict[str, str]) -> None:
        self._action = SHOW_VALUE
        if actions:
            text('A click sets', 'soft small')
            choice = ui.toggle({SHOW_VALUE: 'Nothing', **actions}, value=SHOW_VALUE)
            choice.on_value_change(self._choose)
            choice.props('dense unelevated toggle-color=primary size=sm no-caps')
        self._words = text('Click a pixel to see its value.', 'small soft grow pixel')
        self._words.props('role=status')

    def _choose(self, event: Any) -> None:
        self._action = event.value

    def _clicked(self, event: Any) -> None:
        at = event.args['detail']
        x, y = int(at['x']), int(at['y'])
        if self._action in (START_ROW, END_ROW):
            row = y + 1 if self._action == END_ROW else y
            self._words.set_text(f'{self._action} {row}')
            self._part.set_parameter(self.stream.node, self._action, row)
            return
        image = self._newest()
        if image is None or not (0 <= x < image.width and 0 <= y < image.height):
            return
        self._words.set_text(pixel_words(image, x, y, self._values))
        if self._action == THRESHOLD:
            self._part.set_parameter(self.stream.node, THRESHOLD, threshold_below(image, x, y))

    def _newest(self) -> Image | None:
        try:
            return self._part.page.services.feed.newest(self.stream.key)
        except ImageError:
            return None

    def _snapshot(self) -> None:
        image = self._newest()
        if image is None:
            tell('There is no image yet.', bad=True)
            return
        name = self.stream.key.strip('/').replace('/', '_').replace(' ', '_')
        ui.download.content(encode_png(image), f'{name}.png', 'image/png')


def pixel_value(image: Image, x: int, y: int) -> float:
    """A pixel's intensity as a fraction of full scale."""
    gray = image.gray()
    return float(gray[y, x]) / (65535.0 if gray.dtype.itemsize == 2 else 255.0)


def threshold_below(image: Image, x: int, y: int) -> float:
    """The threshold, in thousandths, that this pixel and all brighter ones exceed."""
    return max(math.ceil(1000.0 * pixel_value(image, x, y)) - 1, 0) / 1000.0


def pixel_words(image: Image, x: int, y: int, values: dict[str, Any]) -> str:
    """A pixel's value as a fraction of full scale, held against the node's threshold."""
    value = pixel_value(image, x, y)
    words = f'x {x}, y {y}: {value:.3f}'
    threshold = values.get(THRESHOLD)
    if isinstance(threshold, float):
        side = 'above' if value > threshold else 'not above'
        return f'{words}, {side} the threshold {threshold:.3f}'
    if not image.is_gray:
        blue, green, red = (int(each) for each in image.bgr()[y, x])
        words += f' (red {red}, green {green}, blue {blue})'
    return words


class Images:
    """The tiles."""

    def __init__(self, page: Page, set_parameter: Callable[[str, str, Value], None]) -> None:
        """Make the part in the place where elements now go.

        Args:
            page: whose nodes' images are shown.
            set_parameter: called with node, parameter and value after a click on an image.
        """
        self.page, self.set_parameter = page, set_parameter
        self._tiles: list[Tile] = []
        self._wished: list[Wish] = []
        self._recorder: Recorder | None = None
        self._recording_ended = 0.0
        with box('part images', 'section').props('role=tabpanel aria-label=Images'):
            with box('bar'):
                button('All windows', lambda: self._preset('all'), 'grid_view')
                button('Raw and result', lambda: self._preset('pair'), 'compare')
                with button('Add image', lambda: None, 'add'):
                    self._menu = ui.menu().on('before-show', self._offer)
                self._record = button('Record', self._toggle_recording, 'fiber_manual_record')
                self._words = text('', 'small soft grow').props('role=status')
            self._grid = box('tiles')
            with box('card') as self._empty:
                empty('No image chosen', 'Add one with the buttons above.')
        page.on_select.append(self.refresh)
        self.refresh()

    def restore(self, kept: Any) -> None:
        """Take the arrangement that the browser has kept."""
        try:
            self._wished = [(str(key), str(size)) for key, size in json.loads(kept)][:MOST_STREAMS]
        except (TypeError, ValueError, RecursionError):
            self._wished = []
        self.refresh()

    def _streams(self) -> dict[str, Stream]:
        nodes = self.page.services.system.nodes.values()
        return {stream.key: stream for node in nodes for stream in streams_of(node)}

    def refresh(self) -> None:
        """After nodes came or went, or another was selected."""
        streams = self._streams()
        wished = [wish for wish in self._wished if wish[0] in streams]
        self._arrange(wished or self._usual('all'), streams)
        self._empty.set_visibility(not self._tiles)

    def _usual(self, preset: str) -> list[Wish]:
        """The selected node's images: the thesis's five windows, or input and result."""
        node = self.page.node
        if node is None:
            return []
        large = (_INPUT, RESULT_OF_KIND[node.kind])
        streams = [stream for stream in streams_of(node) if preset == 'all' or stream.name in large]
        streams.sort(key=lambda stream: stream.name not in large)
        return [(stream.key, 'm' if stream.name in large else 's') for stream in streams]

    def _arrange(self, wished: Iterable[Wish], streams: dict[str, Stream]) -> None:
        wishes = list(wished)
        if [(tile.stream.key, tile.size) for tile in self._tiles] == wishes:
            return
        self._grid.clear()
        with self._grid:
            self._tiles = [
                Tile(streams[key], self, size if size in _SIZES else 'm') for key, size in wishes
            ]

    def _preset(self, name: str) -> None:
        # None wished: the images of whatever node is selected.
        self._wished = [] if name == 'all' else self._usual(name)
        self._keep()

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
            tell(f'There are {MOST_STREAMS} images already, and no more are sent.', bad=True)
            return
        self._set([*self._wishes(), (key, 'm')])

    def _wishes(self) -> list[Wish]:
        return [(tile.stream.key, tile.size) for tile in self._tiles]

    def _set(self, wishes: list[Wish]) -> None:
        self._wished = wishes
        self._keep()

    def _keep(self) -> None:
        self.refresh()
        kept = json.dumps(self._wished)
        ui.run_javascript(f'localStorage.setItem({json.dumps(_KEPT)}, {json.dumps(kept)})')

    def show_values(self) -> None:
        """After a node's values changed."""
        for tile in self._tiles:
            tile.show_values()

    def remove(self, tile: Tile) -> None:
        """Show one less."""
        self._set([wish for wish in self._wishes() if wish[0] != tile.stream.key])

    def move(self, tile: Tile, by: int) -> None:
        """Put a tile further to the front or to the back."""
        wishes = self._wishes()
        old = self._tiles.index(tile)
        wishes.insert(min(max(old + by, 0), len(wishes) - 1), wishes.pop(old))
        self._set(wishes)

    def resize(self, tile: Tile) -> None:
        """A third, a half and the whole of the width in turn."""
        size = _SIZES[(_SIZES.index(tile.size) + 1) % len(_SIZES)]
        self._set([(k, size if k == tile.stream.key else old) for k, old in self._wishes()])

    async def _toggle_recording(self) -> None:
        if self._recorder is not None:
            await self.stop_recording()
            return
        node, services = self.page.node, self.page.services
        if node is None:
            tell('There is no node to record.', bad=True)
            return
        name = f'{node.kind} {time.strftime("%Y-%m-%d %H.%M.%S")}.mcap'
        try:
            self._recorder = Recorder(services.ros, node, services.recordings / name)
        except (RecordingError, OSError) as error:
            tell(str(error), bad=True)
        self.show_recording()

    def show_recording(self) -> None:
        """How far the recording is."""
        recorder = self._recorder
        self._record.set_text('Stop' if recorder else 'Record')
        if recorder is not None:
            words = f'{recorder.messages} messages, {recorder.seconds:.0f} s'
            self._words.set_text(f'Recording {recorder.path.name}: {words}')

    async def stop_recording(self) -> None:
        """End it, also when the page is closed."""
        recorder, self._recorder = self._recorder, None
        if recorder is None:
            return
        try:
            await recorder.stop()
            said = f'Recorded {recorder.messages} messages: {recorder.path}'
        except RecordingError as error:
            said = str(error)
        if not self._words.is_deleted:
            self._words.set_text(foreign.words(f'{said} {recorder.error}'))
            self.show_recording()
        self.page.services.runs_changed.emit()

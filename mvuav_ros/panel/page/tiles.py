"""The part with images: tiles of one image each."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from nicegui import ui

from mvuav_ros.panel.image_feed import INPUT, MAX_STREAMS, ImageStream, encode_png, streams_of
from mvuav_ros.panel.page import elements as el
from mvuav_ros.panel.page.context import Page
from mvuav_ros.parameters.declaration import Value
from mvuav_ros.processing.registry import PROCESSORS
from mvuav_ros.vision.image import CHANNELS, Image

_SIZES = ('s', 'm', 'l')
_KEPT = 'tuning_panel_images'
SHOW_VALUE, THRESHOLD, START_ROW, END_ROW = 'Value', 'threshold', 'start_row', 'end_row'
_NOTHING = {SHOW_VALUE: 'Nothing'}
_ACTIONS = {THRESHOLD: 'Threshold', START_ROW: 'Start row', END_ROW: 'End row'}
_NO_IMAGE = 'There is no such image any more, or not yet.'

Wish = tuple[str, str]
"""A stream's key and a size."""


class Images:
    """The tiles; a click on one calls ``set_parameter`` with node, parameter and value."""

    def __init__(self, page: Page, set_parameter: Callable[[str, str, Value], None]) -> None:
        self.page, self.set_parameter = page, set_parameter
        self._tiles: list[Tile] = []
        self._wished: list[Wish] = []
        with el.box('part images'):
            with el.box('bar'):
                el.button('All windows', lambda: self._wish([]), 'grid_view')
                el.button('Raw and result', lambda: self._wish(self._usual(pair=True)), 'compare')
                with el.button('Add image', None, 'add'):
                    self._menu = ui.menu().on('before-show', self._offer)
            self._grid = el.box('tiles')
            with el.box('card') as self._empty:
                el.empty('No image chosen', 'Add one with the buttons above.')

    async def restore(self) -> None:
        """Take the arrangement that the browser has kept; on a slow link the usual will do."""
        with suppress(TimeoutError, TypeError, ValueError, RecursionError):
            script = f'return localStorage.getItem({json.dumps(_KEPT)})'
            kept = json.loads(await ui.run_javascript(script, timeout=10.0))
            wishes = [(str(key), str(size)) for key, size in kept][:MAX_STREAMS]
            self._wished = [wish for wish in wishes if wish[1] in _SIZES]
            self.refresh()

    def _streams(self) -> dict[str, ImageStream]:
        nodes = self.page.services.system.nodes.values()
        return {stream.key: stream for node in nodes for stream in streams_of(node)}

    def refresh(self) -> None:
        """After nodes came or went, another was selected, or values changed."""
        streams = self._streams()
        wishes = [wish for wish in self._wished if wish[0] in streams] or self._usual()
        if wishes != self._shown():
            self._grid.clear()
            with self._grid:
                self._tiles = [Tile(streams[key], self, size) for key, size in wishes]
        for tile in self._tiles:
            tile.show_values()
        self._empty.set_visibility(not self._tiles)

    def _usual(self, *, pair: bool = False) -> list[Wish]:
        """The selected node's images: the thesis's five windows, or input and result."""
        node = self.page.node
        if node is None:
            return []
        large = (INPUT, PROCESSORS[node.kind].panel.image)
        # Mode approach draws the result only.
        pair = pair or node.values.get('mode') == 'approach'
        streams = [stream for stream in streams_of(node) if stream.name in large or not pair]
        streams.sort(key=lambda stream: stream.name not in large)
        return [(stream.key, 'm' if stream.name in large else 's') for stream in streams]

    def _shown(self) -> list[Wish]:
        return [(tile.stream.key, tile.size) for tile in self._tiles]

    def _wish(self, wishes: list[Wish]) -> None:
        """Show these, on the next visit too; none: the usual ones of whatever node is selected."""
        self._wished, kept = wishes, json.dumps(wishes)
        # Before the tile goes whose button was pressed, by which NiceGUI knows the page.
        ui.run_javascript(f'localStorage.setItem({json.dumps(_KEPT)}, {json.dumps(kept)})')
        self.refresh()

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
                el.text('All are shown' if shown else 'No node yet', 'q-pa-sm soft')

    def _add(self, key: str) -> None:
        if len(self._tiles) >= MAX_STREAMS:
            el.notify(f'At most {MAX_STREAMS} images can be shown.', bad=True)
            return
        self._wish([*self._shown(), (key, 'm')])


class Tile:
    """One image."""

    def __init__(self, stream: ImageStream, part: Images, size: str) -> None:
        self.stream, self.size, self._part = stream, size, part
        self._is_held = False
        self._held: Image | None = None
        change = partial(part.rearrange, self)
        named = f'{stream.title} of {stream.node}'
        with el.set_props(el.box(f'card tile {size}', 'article'), aria_label=named):
            with el.box('tile-head'):
                el.text(stream.title, 'title')
                el.text(stream.node, 'soft small grow title')
                el.text('', 'rate number small soft')
                el.icon_button('chevron_left', 'Move to the front', lambda: change('forward'))
                el.icon_button('chevron_right', 'Move to the back', lambda: change('back'))
                el.icon_button('photo_size_select_large', 'Another size', lambda: change('size'))
                el.icon_button('photo_camera', 'Save this image as PNG', self._snapshot)
                el.icon_button('close', 'Remove', lambda: change('remove'))
            with el.box('well').props('data-fresh=never'):
                self._canvas = el.box('image', 'canvas').props('role=img')
                self._canvas.on('held', self._hold, ['detail'])
                el.set_props(self._canvas, data_key=stream.key, aria_label=stream.title)
                el.text('Waiting for images', 'waiting')
            if stream.name == INPUT:
                self._canvas.classes('clickable')
                self._canvas.on('pixel', self._clicked, ['detail'])
                with el.box('tile-foot'):
                    with el.box('line') as self._offer:
                        el.text('A click sets', 'soft small')
                        self._action = ui.toggle(_NOTHING, value=SHOW_VALUE)
                        self._action.props('dense unelevated toggle-color=primary size=sm no-caps')
                    self._words = el.text('Click a pixel to see its value.', 'small soft grow')
                    self._words.classes('pixel').props('role=status')

    @property
    def _values(self) -> dict[str, Any]:
        node = self._part.page.services.system.nodes.get(self.stream.node)
        if node is None:
            return {}
        counting = (control.name for control in node.controls if control.has_effect(node.values))
        return {name: node.values.get(name) for name in counting}

    def show_values(self) -> None:
        """Follow the node's values: the rows searched, and what a click can set."""
        if self.stream.name != INPUT:
            return
        values = self._values
        rows = [values.get(name) for name in (START_ROW, END_ROW)]
        shown = ','.join(map(str, rows)) if None not in rows else ''
        el.set_props(self._canvas, data_rows=shown)
        actions = _NOTHING | {key: words for key, words in _ACTIONS.items() if key in values}
        if actions != self._action.options:
            now = self._action.value
            self._action.set_options(actions, value=now if now in actions else SHOW_VALUE)
        self._offer.set_visibility(actions != _NOTHING)

    def _hold(self, event: Any) -> None:
        """Keep the image that stands still on the screen, or go on with the newest."""
        said, feed = event.args['detail'], self._part.page.services.feed
        self._is_held = bool(said['held'])
        self._held = feed.image(self.stream.key, int(said['number'])) if self._is_held else None

    def _image(self) -> Image | None:
        return self._held if self._is_held else self._part.page.services.feed.image(self.stream.key)

    def _clicked(self, event: Any) -> None:
        at, action, node = event.args['detail'], self._action.value, self.stream.node
        x, y = int(at['x']), int(at['y'])
        if action in (START_ROW, END_ROW):
            row = y + 1 if action == END_ROW else y
            self._words.set_text(f'{action} {row}')
            self._part.set_parameter(node, action, row)
            return
        image = self._image()
        if image is None:
            self._words.set_text(_NO_IMAGE)
        elif 0 <= x < image.width and 0 <= y < image.height:
            value = value_at(image, x, y, self._values.get('channel'))
            self._words.set_text(pixel_words(image, x, y, value, self._values.get(THRESHOLD)))
            if action == THRESHOLD:
                # In thousandths; this pixel and all brighter ones exceed it.
                below = max(math.ceil(1000.0 * value) - 1, 0) / 1000.0
                self._part.set_parameter(node, THRESHOLD, below)

    def _snapshot(self) -> None:
        image = self._image()
        if image is None:
            el.notify(_NO_IMAGE, bad=True)
            return
        name = self.stream.key.strip('/').replace('/', '_').replace(' ', '_')
        ui.download.content(encode_png(image), f'{name}.png', 'image/png')


def value_at(image: Image, x: int, y: int, channel: object) -> float:
    """A pixel as a fraction of full scale, in a channel of the node's, else its intensity."""
    gray = image.seen_in(str(channel) if channel in CHANNELS else 'intensity').gray()
    return float(gray[y, x]) / float(np.iinfo(gray.dtype).max)


def pixel_words(image: Image, x: int, y: int, value: float, threshold: object) -> str:
    """A pixel's value as a fraction of full scale, held against the node's threshold."""
    words = f'x {x}, y {y}: {value:.3f}'
    if isinstance(threshold, float):
        side = 'above' if value > threshold else 'not above'
        return f'{words}, {side} the threshold {threshold:.3f}'
    if not image.is_gray:
        blue, green, red = image.bgr()[y, x].tolist()
        words += f' (red {red}, green {green}, blue {blue})'
    return words

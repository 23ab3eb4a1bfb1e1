"""The part with the images, chosen and arranged by the user."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from typing import Any

from nicegui import ui

from mvuav_ros.panel.images import Stream, streams_of
from mvuav_ros.panel.page.context import Page
from mvuav_ros.panel.page.elements import box, empty, icon_button, text
from mvuav_ros.parameters.declaration import Value
from mvuav_ros.vision.image import Image, ImageError

_SIZES = ('s', 'm', 'l')
_SHOWN_FIRST = ('input', 'debug/overlay', 'debug_image')
_KEPT = 'tuning_panel_images'
SHOW_VALUE, START_ROW, END_ROW = 'Value', 'start_row', 'end_row'


class Tile:
    """One image."""

    def __init__(self, stream: Stream, part: Images, size: str) -> None:
        self.stream, self.size, self._part = stream, size, part
        self._action = SHOW_VALUE
        with box(f'card tile {size}', 'article') as self.element:
            self.element.props['aria-label'] = f'{stream.title} of {stream.node}'
            with box('tile-head'):
                text(stream.title, 'title')
                text(stream.node, 'soft small grow title').style('margin-left: 6px')
                icon_button('chevron_left', 'Move to the front', lambda: part.move(self, -1))
                icon_button('chevron_right', 'Move to the back', lambda: part.move(self, 1))
                icon_button('photo_size_select_large', 'Another size', lambda: part.resize(self))
                icon_button('close', 'Remove', lambda: part.remove(self))
            with box('well').props('data-fresh=never'):
                self._canvas = box('image', 'canvas')
                self._canvas.props['data-key'] = stream.key
                self._canvas.props['role'] = 'img'
                self._canvas.props['aria-label'] = stream.title
                text('Waiting for images', 'waiting')
            if stream.name == 'input':
                self._clicks()
        self.show_rows()

    def _clicks(self) -> None:
        node = self._part.page.services.system.nodes.get(self.stream.node)
        actions = {SHOW_VALUE: 'Value'}
        if node is not None and node.kind == 'runway_detector':
            actions |= {START_ROW: 'Start row', END_ROW: 'End row'}
        self._canvas.classes('clickable')
        self._canvas.on('pixel', self._clicked, ['detail'])
        with box('tile-foot'):
            if len(actions) > 1:
                text('A click sets', 'soft small')
                choice = ui.toggle(actions, value=SHOW_VALUE, on_change=self._choose)
                choice.props('dense unelevated toggle-color=primary size=sm no-caps')
            self._words = text('Click a pixel to see its value.', 'small soft grow')
            self._words.style('min-width: 170px').props('role=status')

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
        try:
            image = self._part.page.services.feed.newest(self.stream.key)
        except ImageError:
            image = None
        node = self._part.page.services.system.nodes.get(self.stream.node)
        if image is not None and node is not None:
            self._words.set_text(pixel_words(image, x, y, node.values))

    def show_rows(self) -> None:
        """Draw the rows searched on the input."""
        node = self._part.page.services.system.nodes.get(self.stream.node)
        if self.stream.name == 'input' and node is not None:
            rows = [node.values.get(name) for name in (START_ROW, END_ROW)]
            words = ','.join(str(row) for row in rows) if None not in rows else ''
            if self._canvas.props.get('data-rows') != words:
                self._canvas.props['data-rows'] = words
                self._canvas.update()


def pixel_words(image: Image, x: int, y: int, values: dict[str, Any]) -> str:
    """A pixel's value as a fraction of full scale, held against the node's threshold."""
    if not (0 <= x < image.width and 0 <= y < image.height):
        return ''
    gray = image.gray()
    value = float(gray[y, x]) / (65535.0 if gray.dtype.itemsize == 2 else 255.0)
    words = f'x {x}, y {y}: {value:.3f}'
    threshold = values.get('threshold')
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
            set_parameter: called with node, parameter and value after a click on a image.
        """
        self.page, self.set_parameter = page, set_parameter
        self._tiles: list[Tile] = []
        self._wished: list[tuple[str, str]] | None = None
        self._touched = False
        self._offered: list[str] | None = None
        with box('part images', 'section').props('aria-label=Images'):
            with box('bar'):
                with ui.button('Add image', icon='add').props('outline dense').classes('q-px-sm'):
                    self._menu = ui.menu()
                text('A image is asked for only while it is on the screen.', 'small soft')
            self._grid = box('tiles')
            with box('card') as self._empty:
                empty('No image chosen', 'Add one with the button above.')
        page.on_select.append(self.refresh)
        self.refresh()

    def restore(self, kept: Any) -> None:
        """Take the arrangement that the browser has kept."""
        try:
            self._wished = [(str(key), str(size)) for key, size in json.loads(kept)]
        except (TypeError, ValueError):
            self._wished = None
        self.refresh()

    def refresh(self) -> None:
        """After nodes came or went, or another was selected."""
        nodes = self.page.services.system.nodes.values()
        streams = {stream.key: stream for node in nodes for stream in streams_of(node)}
        if not self._touched and streams:
            self._arrange(streams)
        shown = {tile.stream.key for tile in self._tiles}
        self._empty.set_visibility(not self._tiles)
        offered = [key for key in streams if key not in shown]
        if offered == self._offered:
            return
        self._offered = offered
        self._menu.clear()
        with self._menu:
            for key in offered:
                words = f'{streams[key].title} of {streams[key].node}'
                add = partial(self.add, streams[key])
                ui.menu_item(words, add, auto_close=False).props('dense')
            if not offered:
                text('All are shown' if streams else 'No node yet', 'q-pa-sm soft')

    def _arrange(self, streams: dict[str, Stream]) -> None:
        """The kept arrangement, or input and overlay of the selected node."""
        wished = self._wished
        if not wished or not any(key in streams for key, _ in wished):
            wished = [
                (key, 'm')
                for key, stream in streams.items()
                if stream.node == self.page.selected and stream.name in _SHOWN_FIRST
            ]
        have = [tile.stream.key for tile in self._tiles]
        if [key for key, _ in wished if key in streams] == have:
            return
        for tile in self._tiles:
            tile.element.delete()
        self._tiles = []
        for key, size in wished:
            if key in streams:
                self._make(streams[key], size if size in _SIZES else 'm')

    def show_values(self) -> None:
        """After a node's values changed."""
        for tile in self._tiles:
            tile.show_rows()

    def _make(self, stream: Stream, size: str) -> None:
        with self._grid:
            self._tiles.append(Tile(stream, self, size))

    def add(self, stream: Stream) -> None:
        """Show one more."""
        # By hand: the item itself does not live to do it.
        self._menu.close()
        self._make(stream, 'm')
        self._changed()

    def remove(self, tile: Tile) -> None:
        """Show one less."""
        self._tiles.remove(tile)
        tile.element.delete()
        self._changed()

    def move(self, tile: Tile, by: int) -> None:
        """Put a tile further to the front or to the back."""
        old = self._tiles.index(tile)
        new = min(max(old + by, 0), len(self._tiles) - 1)
        self._tiles.insert(new, self._tiles.pop(old))
        tile.element.move(self._grid, new)
        self._changed()

    def resize(self, tile: Tile) -> None:
        """A third, a half and the whole of the width in turn."""
        tile.element.classes(remove=tile.size)
        tile.size = _SIZES[(_SIZES.index(tile.size) + 1) % len(_SIZES)]
        tile.element.classes(add=tile.size)
        self._changed()

    def _changed(self) -> None:
        self._touched = True
        self.refresh()
        kept = json.dumps([(tile.stream.key, tile.size) for tile in self._tiles])
        ui.run_javascript(f'localStorage.setItem({json.dumps(_KEPT)}, {json.dumps(kept)})')


KEPT_ARRANGEMENT = f'return localStorage.getItem({json.dumps(_KEPT)})'
"""JavaScript for `Images.restore`."""

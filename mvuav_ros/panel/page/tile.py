"""One image of the part with the images: its canvas, its buttons, and what a click on it does."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from nicegui import ui

from mvuav_ros.panel.images import INPUT, Stream, encode_png
from mvuav_ros.panel.page.elements import box, icon_button, set_prop, tell, text
from mvuav_ros.vision.image import Image, ImageError

if TYPE_CHECKING:
    from mvuav_ros.panel.page.images import Images

SHOW_VALUE, THRESHOLD, START_ROW, END_ROW = 'Value', 'threshold', 'start_row', 'end_row'
_NOTHING = {SHOW_VALUE: 'Nothing'}
_ACTIONS = {THRESHOLD: 'Threshold', START_ROW: 'Start row', END_ROW: 'End row'}


class Tile:
    """One image."""

    def __init__(self, stream: Stream, part: Images, size: str) -> None:
        self.stream, self.size, self._part = stream, size, part
        change = part.rearrange
        with box(f'card tile {size}', 'article') as element:
            element.props['aria-label'] = f'{stream.title} of {stream.node}'
            with box('tile-head'):
                text(stream.title, 'title')
                text(stream.node, 'soft small grow title')
                text('', 'rate number small soft')
                icon_button('chevron_left', 'Move to the front', lambda: change(self, 'forward'))
                icon_button('chevron_right', 'Move to the back', lambda: change(self, 'back'))
                icon_button('photo_size_select_large', 'Another size', lambda: change(self, 'size'))
                icon_button('photo_camera', 'Save this image as PNG', self._snapshot)
                icon_button('close', 'Remove', lambda: change(self, 'remove'))
            with box('well').props('data-fresh=never'):
                self._canvas = box('image', 'canvas').props('role=img')
                self._canvas.props['data-key'] = stream.key
                self._canvas.props['aria-label'] = stream.title
                text('Waiting for images', 'waiting')
            if stream.name == INPUT:
                self._canvas.classes('clickable')
                self._canvas.on('pixel', self._clicked, ['detail'])
                with box('tile-foot'):
                    with box('line') as self._offer:
                        text('A click sets', 'soft small')
                        self._action = ui.toggle(_NOTHING, value=SHOW_VALUE)
                        self._action.props('dense unelevated toggle-color=primary size=sm no-caps')
                    self._words = text('Click a pixel to see its value.', 'small soft grow pixel')
                    self._words.props('role=status')
        self.show_values()

    @property
    def _values(self) -> dict[str, Any]:
        node = self._part.page.services.system.nodes.get(self.stream.node)
        controls = node.controls if node is not None else []
        return {c.name: node.values.get(c.name) for c in controls if node and c.counts(node.values)}

    def show_values(self) -> None:
        """Follow the node's values: the rows searched, and what a click can set."""
        if self.stream.name != INPUT:
            return
        values = self._values
        rows = [values.get(name) for name in (START_ROW, END_ROW)]
        shown = ','.join(map(str, rows)) if None not in rows else ''
        set_prop(self._canvas, 'data-rows', shown)
        actions = _NOTHING | {key: words for key, words in _ACTIONS.items() if key in values}
        if actions != self._action.options:
            now = self._action.value
            self._action.set_options(actions, value=now if now in actions else SHOW_VALUE)
        self._offer.set_visibility(actions != _NOTHING)

    def _clicked(self, event: Any) -> None:
        at, action, node = event.args['detail'], self._action.value, self.stream.node
        x, y = int(at['x']), int(at['y'])
        if action in (START_ROW, END_ROW):
            row = y + 1 if action == END_ROW else y
            self._words.set_text(f'{action} {row}')
            self._part.set_parameter(node, action, row)
            return
        image = self._newest()
        if image is not None and 0 <= x < image.width and 0 <= y < image.height:
            self._words.set_text(pixel_words(image, x, y, self._values.get(THRESHOLD)))
            if action == THRESHOLD:
                self._part.set_parameter(node, THRESHOLD, threshold_below(image, x, y))

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


def pixel_words(image: Image, x: int, y: int, threshold: object) -> str:
    """A pixel's value as a fraction of full scale, held against the node's threshold."""
    value = pixel_value(image, x, y)
    words = f'x {x}, y {y}: {value:.3f}'
    if isinstance(threshold, float):
        side = 'above' if value > threshold else 'not above'
        return f'{words}, {side} the threshold {threshold:.3f}'
    if not image.is_gray:
        blue, green, red = image.bgr()[y, x].tolist()
        words += f' (red {red}, green {green}, blue {blue})'
    return words

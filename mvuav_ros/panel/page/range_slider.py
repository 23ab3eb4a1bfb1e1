"""A slider over given values that follows the hand and speaks its value with the unit.

The browser's own range input: Quasar's slider puts the keyboard's focus on an element without a
role. ``static/live.js`` places its thumb and writes what it speaks.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mvuav_ros.panel.controls import Scale, value_text
from mvuav_ros.panel.page.elements import box, set_prop


class RangeSlider:
    """Positions are those of a `Scale`."""

    def __init__(self, label: str, unit: str, moved: Callable[[float], Any]) -> None:
        """Make it in the place where elements now go.

        Args:
            label: its name.
            unit: spoken behind the value.
            moved: called with the new value while the user moves it.
        """
        self._moved = moved
        self._scale = Scale((0.0,))
        self.element = box('range', 'input').props('type=range min=0 step=1')
        self.element.props['aria-label'] = label
        self.element.props['data-unit'] = unit
        self.element.on(
            'input', self._on_input, js_handler='(e) => emit(e.target.value)', throttle=0.05
        )

    def set_scale(self, scale: Scale) -> None:
        """Change the values."""
        self._scale = scale
        set_prop(self.element, 'max', len(scale.values) - 1)
        set_prop(self.element, 'data-values', ' '.join(map(value_text, scale.values)))

    def show(self, value: object) -> None:
        """Place the thumb; what is no number has no place."""
        if isinstance(value, (int, float)):
            set_prop(self.element, 'data-index', self._scale.position(value))

    def _on_input(self, event: Any) -> None:
        position = int(event.args)
        if 0 <= position < len(self._scale.values):
            # No update of the page: the thumb is there already.
            self._moved(self._scale.values[position])

"""One parameter: its current value, the edited one beside it, and what the node said of that."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nicegui import ui

from mvuav_ros.panel import foreign
from mvuav_ros.panel.controls import Control, Kind, scale_of, value_text
from mvuav_ros.panel.live_system import same_value
from mvuav_ros.panel.page.elements import box, set_class, text
from mvuav_ros.panel.page.range_slider import RangeSlider
from mvuav_ros.panel.page.value_field import ValueField
from mvuav_ros.parameters.declaration import Value

Edited = Callable[[str, Value], Any]


class ParameterRow:
    """A parameter's line of the list."""

    def __init__(self, control: Control, value: Any, image_size: int, edited: Edited) -> None:
        """Make the line in the place where elements now go.

        Args:
            control: what the descriptor says.
            value: the current one.
            image_size: longer side of the node's images, px; 0: not known.
            edited: called with name and value whenever the user has changed it.
        """
        self.control = control
        self._edited = edited
        self._current: Any = value
        self._shown: Any = value
        self._image_size = -1
        self._refused = ''
        self._difference = ''
        self._slider: RangeSlider | None = None
        with box(f'param of-{control.kind.value}') as self._row:
            # As an item: `props` would read a name as markup of its own.
            self._row.props['data-parameter'] = control.label
            self._name()
            self._now = text(value_text(value), 'now')
            with box('edit'):
                self._field = ValueField(control, value, self._entered, self.refuse)
            if control.kind is Kind.SLIDER and not control.read_only:
                self._slider = RangeSlider(control.label, control.text.unit, self._entered)
            self._hint = text('', 'hint').props('aria-live=polite')
        self.fit(image_size)
        self._say()

    def _name(self) -> None:
        with box('name'):
            # May break after an underscore only.
            for number, word in enumerate(self.control.label.split('_')):
                if number:
                    box(tag='wbr')
                text(f'_{word}' if number else word, tag='span')
            with ui.tooltip().props(
                'max-width=320px delay=600 anchor="top left" self="bottom left"'
            ):
                text(self._description)

    @property
    def _description(self) -> str:
        said = self.control.text
        thesis = f' Thesis: {said.thesis}.' if said.thesis else ''
        return (said.description or 'No description.') + thesis

    def matches(self, words: str) -> bool:
        """Whether every typed word occurs in name, description or thesis."""
        said = f'{self.control.label} {self._description} {self.control.stage}'.lower()
        return all(word in said for word in words.lower().split())

    def place(self, *, visible: bool, counts: bool) -> None:
        """Show or hide the line; one that does not count is drawn back."""
        self._row.set_visibility(visible)
        set_class(self._row, 'idle', not counts)

    def fit(self, image_size: int) -> None:
        """Let a slider for places and lengths in the image end where the image does."""
        if self._slider is not None and image_size != self._image_size:
            self._image_size = image_size
            self._slider.set_scale(scale_of(self.control, image_size))
            self._slider.show(self._shown)

    def show(self, value: Any, edit: Value | None = None) -> None:
        """Show the node's value, and beside it the user's where the node has not taken that."""
        if not same_value(value, self._current):
            self._current = value
            self._now.set_text(value_text(value))
        self._show_new(value if edit is None else edit, self._refused if edit is not None else '')

    def refuse(self, reason: str) -> None:
        """Show why the edited value was not taken; it stays in its field."""
        self._refused = foreign.words(reason)
        self._say()

    def mark_difference(self, other: str) -> None:
        """Mark a value other than the chosen set's, which ``other`` names; '' where it is that."""
        if other != self._difference:
            self._difference = other
            self._say()

    def _entered(self, value: Value) -> None:
        self._show_new(value, '')
        self._edited(self.control.name, value)

    def _show_new(self, value: Any, refused: str) -> None:
        self._shown, self._refused = value, refused
        self._field.show(value)
        if self._slider is not None:
            self._slider.show(value)
        self._say()

    def _say(self) -> None:
        """The line below: the node's reason, or range, unit and default."""
        control, said = self.control, self.control.text
        words = [self._difference, '' if control.kind is Kind.MENU else control.constraint]
        words += [said.unit, f'default {said.default}' if said.default else '']
        words += ['set at the start only'] if control.read_only else []
        plain = ' · '.join(word for word in words if word)
        self._hint.set_text(self._refused or foreign.words(plain or said.description))
        set_class(self._hint, 'refused', bool(self._refused))
        set_class(self._row, 'off-set', bool(self._difference))
        pending = bool(self._refused) or not same_value(self._shown, self._current)
        set_class(self._row, 'pending', pending)

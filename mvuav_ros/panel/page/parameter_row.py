"""One parameter: its current value, the edited one beside it, and what the node said of that."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nicegui import ui

from mvuav_ros.panel.controls import Control, Kind, scale_of, value_text
from mvuav_ros.panel.page.elements import LocalSlider, box, text
from mvuav_ros.parameters.declaration import Value

STEPS = 1000
"""Positions of a slider."""

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
        self._pending = False
        self._scale = scale_of(control)
        self._slider: LocalSlider | None = None
        self._field: Any = None
        with box('param') as self._row:
            self._row.props(f'data-parameter={control.name}')
            self._name()
            self._now = text(value_text(value), 'now')
            with box('edit'):
                self._make_field(value)
            if control.kind is Kind.SLIDER and not control.read_only:
                self._make_slider()
            self._hint = text(self._plain_hint, 'hint').props('aria-live=polite')
            self._about = text(self._description, 'about').props('hidden')
        self.fit(image_size)
        self._show_field(value)

    def _name(self) -> None:
        made = box('name', 'button').props('type=button aria-expanded=false')
        with made:
            # May break after an underscore only.
            for number, word in enumerate(self.control.name.split('_')):
                if number:
                    box(tag='wbr')
                text(f'_{word}' if number else word, tag='span')
            with ui.tooltip().classes('small').props('max-width=320px delay=400'):
                text(self._description)
        made.on('click', self._toggle_about)

    @property
    def _description(self) -> str:
        thesis = f' Thesis: {self.control.thesis}.' if self.control.thesis else ''
        return (self.control.description or 'No description.') + thesis

    @property
    def _plain_hint(self) -> str:
        menu = self.control.kind is Kind.MENU
        words = ['' if menu else self.control.constraint, self.control.unit]
        words += ['set at the start only'] if self.control.read_only else []
        return ' · '.join(word for word in words if word) or self.control.description

    def _toggle_about(self) -> None:
        if 'hidden' in self._about.props:
            self._about.props(remove='hidden')
        else:
            self._about.props('hidden')

    def _make_field(self, value: Any) -> None:
        control = self.control
        if control.kind is Kind.SWITCH:
            made: Any = ui.switch(value=bool(value), on_change=lambda e: self._edit(e.value))
            made.props('dense')
        elif control.kind is Kind.MENU:
            made = ui.select(
                list(control.choices), value=value, on_change=lambda e: self._edit(e.value)
            )
            made.props('outlined dense options-dense')
        else:
            made = ui.input(value=value_text(value)).props('outlined dense')
            if control.type in (int, float):
                made.props('inputmode=decimal')
            made.on('keydown.enter', self._typed).on('blur', self._typed)
        made.props['aria-label'] = control.name
        if control.read_only:
            made.disable()
        self._field = made

    def _make_slider(self) -> None:
        with box('wide'):
            self._slider = LocalSlider(
                min=0,
                max=STEPS,
                step=1,
                value=self._position(self._current),
                on_change=lambda e: self._slid(e.value),
            )
            self._slider.props['aria-label'] = f'{self.control.name}, slider'

    def fit(self, image_size: int) -> None:
        """Let a slider for places and lengths in the image end where the image does."""
        if self._slider is not None and self.control.unit == 'px' and image_size > 0:
            scale = scale_of(self.control).within(max(image_size, float(self._current)))
            if scale != self._scale:
                self._scale = scale
                self._show_field(self._current)

    def _typed(self) -> None:
        words = self._field.value
        if str(words) == self._field_text(self._current) and not self._pending:
            return
        try:
            value = self.control.parse(words)
        except ValueError:
            kind = 'a whole number' if self.control.type is int else 'a number'
            self.refuse(f'takes {kind}')
            return
        self._place_slider(value)
        self._edit(value)

    def _slid(self, position: float | None) -> None:
        if position is not None and not self._quiet:
            value = self._scale.value(position / STEPS)
            self._set_quietly(self._field, self._field_text(value))
            self._edit(value)

    def _edit(self, value: Any) -> None:
        if not self._quiet and (value != self._current or self._pending):
            self._mark(pending=True)
            self._edited(self.control.name, value)

    _quiet = False

    def _set_quietly(self, element: Any, value: Any) -> None:
        self._quiet = True
        try:
            element.value = value
        finally:
            self._quiet = False

    def show(self, value: Any, *, editing: bool = False) -> None:
        """Show the node's value; the edited one follows unless the user is at it."""
        if value != self._current:
            self._current = value
            self._now.set_text(value_text(value))
        if not editing:
            self._show_field(value)
            self._mark(pending=False)

    def propose(self, value: Any) -> None:
        """Show a value as edited and not yet applied."""
        self._show_field(value)
        self._mark(pending=True)

    def settled(self) -> None:
        """The edited value is the node's now."""
        self._mark(pending=False)
        self._words(self._plain_hint, refused=False)

    def refuse(self, reason: str) -> None:
        """Show why the edited value was not taken; it stays in its field."""
        self._mark(pending=True)
        self._words(reason, refused=True)

    def mark_difference(self, other: str) -> None:
        """Mark a value other than the chosen set's, which ``other`` names; '' where it is that."""
        self._row.classes(add='off-set') if other else self._row.classes(remove='off-set')
        if not self._refused:
            self._words(
                f'{other} · {self._plain_hint}' if other else self._plain_hint, refused=False
            )

    _refused = False

    def _words(self, words: str, *, refused: bool) -> None:
        self._refused = refused
        self._hint.set_text(words)
        self._hint.classes(add='refused') if refused else self._hint.classes(remove='refused')

    def _mark(self, *, pending: bool) -> None:
        if pending != self._pending:
            self._pending = pending
            self._row.classes(add='pending') if pending else self._row.classes(remove='pending')
        if not pending and self._refused:
            self._words(self._plain_hint, refused=False)

    def _show_field(self, value: Any) -> None:
        if self.control.kind in (Kind.SWITCH, Kind.MENU):
            self._set_quietly(self._field, value)
        else:
            self._set_quietly(self._field, self._field_text(value))
        self._place_slider(value)

    def _field_text(self, value: Any) -> str:
        return str(value) if isinstance(value, str) else value_text(value)

    def _position(self, value: Any) -> int:
        return round(self._scale.position(float(value)) * STEPS)

    def _place_slider(self, value: Any) -> None:
        if self._slider is not None and isinstance(value, (int, float)):
            position = self._position(value)
            if self._scale.value((self._slider.value or 0) / STEPS) != value:
                self._set_quietly(self._slider, position)

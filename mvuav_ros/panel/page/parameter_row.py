"""One parameter: its current value, the edited one beside it, and what the node said of that."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nicegui import ui

from mvuav_ros.panel import foreign
from mvuav_ros.panel.controls import Control, Kind, position_on, scale_of, value_text
from mvuav_ros.panel.live_node import same_value
from mvuav_ros.panel.page import elements as el
from mvuav_ros.parameters.declaration import Value


class ParameterRow:
    """A parameter's line of the list; ``edited`` is called whenever the user has changed the value.

    It is ``changed`` where the node's value is not that of the chosen set, or not the default.

    What the user is typing is never overwritten, whoever changes the parameter meanwhile.
    """

    def __init__(
        self, control: Control, value: Any, edited: Callable[[str, Value], object]
    ) -> None:
        self.control = control
        self._edited = edited
        self._current: Any = value
        self._new: Any = value
        self._base: Value | None = None
        self.changed = False
        self._image_size = -1
        self._refused = self._difference = ''
        self._slider: ui.element | None = None
        thesis = f' Thesis: {control.text.thesis}.' if control.text.thesis else ''
        self._description = (control.text.description or 'No description.') + thesis
        with el.box(f'param of-{control.kind.value}') as self._row:
            el.set_props(self._row, data_parameter=control.label)
            with el.box('named'):
                _show_name(control.label, self._description)
                self._reset = el.icon_button('settings_backup_restore', 'Reset', self._restore)
            self._now = el.text(value_text(value), 'now')
            with el.box('edit'):
                self._field = self._make_field()
            if control.kind is Kind.SLIDER and not control.read_only:
                # The browser's own: Quasar's puts the keyboard's focus on an element without a
                # role. ``static/live.js`` places its thumb and writes what it speaks.
                slider = el.box('range', 'input').props('type=range min=0 step=1')
                el.set_props(slider, aria_label=control.label, data_unit=control.text.unit)
                move = '(e) => emit(e.target.value)'
                self._slider = slider.on('input', self._moved, js_handler=move, throttle=0.05)
            self._hint = el.text('', 'hint').props('aria-live=polite')

    def _make_field(self) -> Any:
        control = self.control
        field: Any
        if control.kind is Kind.SWITCH:
            field = ui.switch(value=self._written, on_change=self._chosen).props('dense')
        elif control.kind is Kind.MENU:
            field = ui.select(self._options, value=self._new, on_change=self._chosen)
            field.props('outlined dense options-dense')
        else:
            field = ui.input(value=self._written).props('outlined dense')
            if control.type in (int, float):
                field.props('inputmode=decimal')
            field.on('keydown.enter', self._commit).on('blur', self._commit)
            field.on('keydown.esc', self._write)
        el.set_props(field, aria_label=f'{control.label}, new value')
        # What cannot be typed as it is must not be changed by being looked at.
        strange = isinstance(self._new, str) and foreign.words(self._new) != self._new
        if control.read_only or strange or (control.type is tuple and isinstance(self._new, str)):
            field.disable()
        return field

    @property
    def _options(self) -> list[Any]:
        """Of a menu; a node's value may be none of the choices."""
        return list(dict.fromkeys((*self.control.choices, self._new)))

    @property
    def _written(self) -> Any:
        """The new value as the field holds it while nobody types."""
        if self.control.kind is Kind.SWITCH:
            return bool(self._new)
        if self.control.kind is Kind.MENU:
            return self._new
        return foreign.words(self._new) if isinstance(self._new, str) else value_text(self._new)

    def matches(self, words: str) -> bool:
        """Whether every typed word occurs in name, description or thesis."""
        said = f'{self.control.label} {self._description} {self.control.stage}'.lower()
        return all(word in said for word in words.lower().split())

    def place(self, *, visible: bool, counts: bool) -> None:
        """Show or hide the line; one that does not count is drawn back."""
        self._row.set_visibility(visible)
        el.set_class(self._row, 'idle', not counts)

    def fit(self, image_size: int) -> None:
        """Let a slider for places and lengths end where the image does; see `scale_of`."""
        if self._slider is not None and image_size != self._image_size:
            self._image_size = image_size
            self._scale = scale_of(self.control, image_size)
            shown = ' '.join(map(value_text, self._scale))
            el.set_props(self._slider, max=len(self._scale) - 1, data_values=shown)
            self._place_thumb()

    def show(
        self,
        value: Any,
        edit: Value | None = None,
        difference: str = '',
        base: Value | None = None,
    ) -> None:
        """Show the node's value, and beside it the user's where the node has not taken that.

        A value that is not the chosen set's is marked; ``difference`` says what that has.
        ``base`` is that set's value, to which it is reset; without one it is the default.
        """
        self._base = self.control.default if base is None else base
        self.changed = self._base is not None and value_text(value) != value_text(self._base)
        self._reset.set_visibility(self.changed and not self.control.read_only)
        el.set_props(self._reset, aria_label=f'Reset {self.control.label}')
        if not same_value(value, self._current):
            self._current = value
            self._now.set_text(value_text(value))
        self._difference = difference
        self._show_new(value if edit is None else edit, self._refused if edit is not None else '')

    def refuse(self, reason: str) -> None:
        """Show why the edited value was not taken; it stays in its field."""
        self._refused = foreign.words(reason)
        self._say()

    def _show_new(self, value: Any, refused: str = '') -> None:
        is_typing = not same_value(self._field.value, self._written)
        self._new, self._refused = value, refused
        if not is_typing:
            self._write()
        self._place_thumb()
        self._say()

    def _write(self) -> None:
        if self.control.kind is Kind.MENU and self._new not in self._field.options:
            self._field.set_options(self._options, value=self._new)
        elif not same_value(self._field.value, self._written):
            self._field.value = self._written

    def _place_thumb(self) -> None:
        # What is no number has no place.
        if self._slider is not None and isinstance(self._new, (int, float)):
            el.set_props(self._slider, data_index=position_on(self._scale, self._new))

    def _restore(self) -> None:
        if self._base is not None:
            self._enter(self._base)

    def _enter(self, value: Value) -> None:
        self._show_new(value)
        self._edited(self.control.name, value)

    def _moved(self, event: Any) -> None:
        position = int(event.args)
        if 0 <= position < len(self._scale):
            self._enter(self._scale[position])

    def _chosen(self, event: Any) -> None:
        if not same_value(event.value, self._written):
            self._enter(event.value)

    def _commit(self) -> None:
        if self._field.value == self._written:
            return
        try:
            value = self.control.parse(self._field.value)
        except ValueError as error:
            self.refuse(str(error))
            return
        if not same_value(value, self._new):
            self._enter(value)
        self._write()

    def _say(self) -> None:
        """The line below: the node's reason, or range, unit and default."""
        control, said = self.control, self.control.text
        words = [self._difference, '' if control.kind is Kind.MENU else control.constraint]
        words += [said.unit, f'default {said.default}' if said.default else '']
        words += ['set at the start only'] if control.read_only else []
        plain = ' · '.join(word for word in words if word)
        self._hint.set_text(self._refused or foreign.words(plain or said.description))
        el.set_class(self._hint, 'refused', bool(self._refused))
        el.set_class(self._row, 'off-set', bool(self._difference))
        pending = bool(self._refused) or not same_value(self._new, self._current)
        el.set_class(self._row, 'pending', pending)


def _show_name(label: str, description: str) -> None:
    """May break after an underscore only."""
    with el.box('name'):
        for number, word in enumerate(label.split('_')):
            if number:
                el.box(tag='wbr')
            el.text(f'_{word}' if number else word, tag='span')
        with ui.tooltip().props('max-width=320px delay=600 anchor="top left" self="bottom left"'):
            el.text(description)

"""The field in which a parameter's value is entered: a switch, a menu, or text."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nicegui import ui

from mvuav_ros.panel import foreign
from mvuav_ros.panel.controls import Control, Kind, value_text
from mvuav_ros.panel.live_system import same_value
from mvuav_ros.parameters.declaration import Value


class ValueField:
    """Shows a value, and takes another one from the user.

    What the user is typing is never overwritten, whoever changes the parameter meanwhile.
    """

    def __init__(
        self,
        control: Control,
        value: Any,
        entered: Callable[[Value], Any],
        refused: Callable[[str], Any],
    ) -> None:
        """Make the field in the place where elements now go.

        Args:
            control: of the parameter.
            value: shown first.
            entered: called with what the user has entered.
            refused: called with the reason where that is no value at all.
        """
        self._control, self._entered, self._refused = control, entered, refused
        self._shown = value
        self._field: Any
        if control.kind is Kind.SWITCH:
            self._field = ui.switch(value=bool(value), on_change=self._chosen).props('dense')
        elif control.kind is Kind.MENU:
            options = list(dict.fromkeys((*control.choices, value)))
            self._field = ui.select(options, value=value, on_change=self._chosen)
            self._field.props('outlined dense options-dense')
        else:
            self._field = ui.input(value=self._written).props('outlined dense')
            if control.type in (int, float):
                self._field.props('inputmode=decimal')
            self._field.on('keydown.enter', self._commit).on('blur', self._commit)
            self._field.on('keydown.esc', self._write)
        self._field.props['aria-label'] = f'{control.label}, new value'
        # What cannot be typed as it is must not be changed by being looked at.
        strange = isinstance(value, str) and (control.type is tuple or not foreign.is_plain(value))
        if control.read_only or strange:
            self._field.disable()

    @property
    def _written(self) -> Any:
        """The value as the field holds it while nobody types."""
        if self._control.kind is Kind.SWITCH:
            return bool(self._shown)
        if self._control.kind is Kind.MENU:
            return self._shown
        shown = self._shown
        return foreign.words(shown) if isinstance(shown, str) else value_text(shown)

    def show(self, value: Any) -> None:
        """Show a value, unless the user is typing another one."""
        is_typing = not same_value(self._field.value, self._written)
        self._shown = value
        if not is_typing:
            self._write()

    def _write(self) -> None:
        if self._control.kind is Kind.MENU and self._shown not in self._field.options:
            options = dict.fromkeys((*self._control.choices, self._shown))
            self._field.set_options(list(options), value=self._shown)
        elif not same_value(self._field.value, self._written):
            self._field.value = self._written

    def _chosen(self, event: Any) -> None:
        if not same_value(event.value, self._written):
            self._shown = event.value
            self._entered(event.value)

    def _commit(self) -> None:
        if self._field.value == self._written:
            return
        try:
            value = self._control.parse(self._field.value)
        except ValueError as error:
            self._refused(str(error))
            return
        changed = not same_value(value, self._shown)
        self._shown = value
        self._write()
        if changed:
            self._entered(value)

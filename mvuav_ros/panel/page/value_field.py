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
        self._quiet = self._typing = False
        if control.kind is Kind.SWITCH:
            self._field: Any = ui.switch(value=bool(value), on_change=self._chosen).props('dense')
        elif control.kind is Kind.MENU:
            self._field = ui.select(
                self._options(value), value=value, on_change=self._chosen
            ).props('outlined dense options-dense')
        else:
            self._field = ui.input(value=_field_text(value), on_change=self._typed)
            self._field.props('outlined dense')
            if control.type in (int, float):
                self._field.props('inputmode=decimal')
            self._field.on('keydown.enter', self._commit).on('blur', self._commit)
            self._field.on('keydown.esc', self._restore)
        self._field.props['aria-label'] = f'{control.label}, new value'
        # What cannot be typed as it is must not be changed by being looked at.
        strange = isinstance(value, str) and (control.type is tuple or not foreign.is_plain(value))
        if control.read_only or strange:
            self._field.disable()

    def show(self, value: Any) -> None:
        """Show a value, unless the user is typing another one."""
        self._shown = value
        if not self._typing:
            self._write(value)

    def _write(self, value: Any) -> None:
        self._quiet = True
        try:
            if self._control.kind is Kind.MENU:
                self._field.set_options(self._options(value), value=value)
            else:
                self._field.value = (
                    bool(value) if self._control.kind is Kind.SWITCH else _field_text(value)
                )
        finally:
            self._quiet = False

    def _options(self, value: Any) -> list[Any]:
        return list(dict.fromkeys((*self._control.choices, value)))

    def _chosen(self, event: Any) -> None:
        if not self._quiet:
            self._shown = event.value
            self._entered(event.value)

    def _typed(self, event: Any) -> None:
        if not self._quiet:
            self._typing = str(event.value) != _field_text(self._shown)

    def _restore(self) -> None:
        self._typing = False
        self._write(self._shown)

    def _commit(self) -> None:
        if not self._typing:
            return
        try:
            value = self._control.parse(self._field.value)
        except ValueError as error:
            self._refused(str(error))
            return
        self._typing = False
        if not same_value(value, self._shown):
            self._shown = value
            self._entered(value)


def _field_text(value: Any) -> str:
    return foreign.words(value) if isinstance(value, str) else value_text(value)

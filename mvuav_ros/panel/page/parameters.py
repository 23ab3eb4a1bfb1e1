"""The part with the chosen node's parameters."""

from __future__ import annotations

import asyncio
from typing import Any

from nicegui import ui

from mvuav_ros.panel.controls import value_text
from mvuav_ros.panel.page.context import Page
from mvuav_ros.panel.page.elements import box, empty, text
from mvuav_ros.panel.page.parameter_row import ParameterRow
from mvuav_ros.panel.page.set_bar import SetBar
from mvuav_ros.parameters.declaration import Value


class Parameters:
    """Every parameter with its control; edits go to the node at once or on a button.

    At once means: one request at a time with the newest values, so that a slow node or link is
    never behind by more than one.
    """

    def __init__(self, page: Page) -> None:
        self._page = page
        self._rows: dict[str, ParameterRow] = {}
        self._edits: dict[str, Value] = {}
        self._sending: set[str] = set()
        self._shown: tuple[object, ...] = ()
        self._at_once = True
        self._list: ui.element
        self._place = box('part parameters', 'section').props('aria-label=Parameters')
        page.on_select.append(self.refresh)
        self.refresh()

    def refresh(self) -> None:
        """Build the list anew where another node is chosen or a node has come back."""
        node = self._page.node
        shown = (node.name, tuple(node.controls), node.alive) if node else ()
        if shown == self._shown and self._rows:
            return
        same = bool(self._shown) and shown[:2] == self._shown[:2] and bool(self._rows)
        self._shown = shown
        if same and node is not None:
            self._list.props('inert') if not node.alive else self._list.props(remove='inert')
            self._list.style('opacity: .5' if not node.alive else 'opacity: 1')
            if node.alive:
                self._edits.clear()
                self.show_values()
            return
        self._rows, self._edits = {}, {}
        self._place.clear()
        with self._place:
            if node is None or not node.controls:
                with box('card'):
                    words = 'They appear as soon as a node answers.'
                    empty('No parameters yet', words)
                return
            with box('card'):
                self._sets = SetBar(self._page, self._load, self.mark_differences)
                self._apply_bar()
                with box() as self._list:
                    self._build()
        self.mark_differences()

    def _apply_bar(self) -> None:
        with box('apply'):
            ui.switch('Apply at once', value=self._at_once, on_change=self._switch).props('dense')
            box('grow')
            self._discard = ui.button('Discard', on_click=self._forget_edits)
            self._discard.props('flat dense').classes('q-px-sm')
            self._apply = ui.button('Apply', on_click=self._apply_all)
            self._apply.props('unelevated dense').classes('q-px-sm')
        self._count_edits()

    def _build(self) -> None:
        node = self._page.node
        assert node is not None
        with box('heads'):
            text('parameter')
            text('now')
            text('new')
        foreign = [control for control in node.controls if control.foreign]
        for control in (c for c in node.controls if not c.foreign):
            self._row(control, node)
        if foreign:
            with ui.expansion('Of every ROS node').classes('small soft').props('dense'):
                for control in foreign:
                    self._row(control, node)

    def _row(self, control: Any, node: Any) -> None:
        value = node.values.get(control.name)
        self._rows[control.name] = ParameterRow(control, value, node.image_size, self._edited)

    def show_values(self) -> None:
        """After the node's values changed, by us or by anybody."""
        node = self._page.node
        if node is None:
            return
        for name, row in self._rows.items():
            row.show(node.values.get(name), editing=name in self._edits or name in self._sending)
        self.mark_differences()

    def show_status(self) -> None:
        """After new diagnostics."""
        node = self._page.node
        if node is not None:
            for row in self._rows.values():
                row.fit(node.image_size)

    def edit(self, name: str, value: Value) -> None:
        """As if the user had entered a value."""
        if name in self._rows:
            self._rows[name].propose(value)
            self._edited(name, value)

    def mark_differences(self) -> None:
        """Mark the rows whose value is not the chosen set's."""
        if not self._rows:
            return
        values = self._page.own_values()
        chosen = self._sets.refresh(values)
        for name, row in self._rows.items():
            other = name in chosen and name in values and chosen[name] != values[name]
            words = f'{self._page.chosen_set}: {value_text(chosen.get(name))}'
            row.mark_difference(words if other else '')

    def _edited(self, name: str, value: Value) -> None:
        self._edits[name] = value
        self._count_edits()
        if self._at_once and name not in self._sending:
            asyncio.create_task(self._send(name))  # noqa: RUF006 - kept in _sending

    async def _send(self, name: str) -> None:
        """Set one parameter until its newest value has been judged."""
        self._sending.add(name)
        node = self._page.selected
        try:
            while name in self._edits and node == self._page.selected:
                value = self._edits.pop(name)
                refused = await self._page.services.system.set(node, {name: value})
                if name not in self._edits:
                    self._judge(name, refused.get(name))
        finally:
            self._sending.discard(name)
            self._count_edits()

    def _judge(self, name: str, reason: str | None) -> None:
        row = self._rows.get(name)
        if row is not None:
            row.refuse(reason) if reason is not None else row.settled()
        self.mark_differences()

    async def _apply_all(self) -> None:
        edits, self._edits = self._edits, {}
        refused = await self._page.services.system.set(self._page.selected, edits)
        for name, value in edits.items():
            if name in refused:
                self._edits[name] = value
            self._judge(name, refused.get(name))
        self._count_edits()

    async def _load(self, values: dict[str, Value]) -> dict[str, str]:
        node = self._page.node
        if node is None:
            return {}
        settable = {c.name for c in node.controls if not c.read_only}
        changes = {
            name: value
            for name, value in values.items()
            if name in settable and node.values.get(name) != value
        }
        self._edits.clear()
        refused = await self._page.services.system.set(node.name, changes) if changes else {}
        self.show_values()
        for name, reason in refused.items():
            if name in self._rows:
                self._rows[name].propose(changes[name])
                self._rows[name].refuse(reason)
        self._count_edits()
        return refused

    def _forget_edits(self) -> None:
        self._edits.clear()
        self.show_values()
        self._count_edits()

    def _switch(self, event: Any) -> None:
        self._at_once = bool(event.value)
        if self._at_once:
            for name in list(self._edits):
                self._edited(name, self._edits[name])
        self._count_edits()

    def _count_edits(self) -> None:
        waiting = len(self._edits) if not self._at_once else 0
        self._apply.set_text(f'Apply {waiting}' if waiting else 'Apply')
        self._apply.set_enabled(waiting > 0)
        self._discard.set_enabled(waiting > 0)

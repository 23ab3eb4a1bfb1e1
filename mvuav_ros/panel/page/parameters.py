"""The part with the chosen node's parameters."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from itertools import groupby
from typing import Any

from nicegui import ui

from mvuav_ros.panel.controls import value_text
from mvuav_ros.panel.images import RESULT_OF_KIND
from mvuav_ros.panel.live_system import LiveNode, same_value
from mvuav_ros.panel.page.context import Page
from mvuav_ros.panel.page.elements import box, button, empty, icon_button, tell, text
from mvuav_ros.panel.page.parameter_row import ParameterRow
from mvuav_ros.panel.page.set_bar import SetBar
from mvuav_ros.parameters.declaration import Value

_STAGES = ('Mode', 'Image', 'Edges', 'Hough', 'Detection', 'Tracking', 'Pose', 'Approach')
_LAST = ('Correction', 'Other', 'Node', 'Every ROS node')
_FOLDED = ('Node', 'Every ROS node')


class Parameters:
    """Every parameter with its control; edits go to the node at once or on a button.

    At once means: one request at a time with the newest values, so that a slow node or link is
    never behind by more than one.
    """

    def __init__(self, page: Page) -> None:
        self._page = page
        self._rows: dict[str, ParameterRow] = {}
        self._stages: dict[str, ui.label] = {}
        self._sending: set[str] = set()
        self._shown: tuple[object, ...] = ()
        self._whole = False
        self._list: ui.element
        self.element = box('part parameters', 'section').props('aria-label=Parameters')
        page.on_select.append(self.refresh)
        page.services.sets_changed.subscribe(self._sets_changed)
        self.refresh()

    @property
    def _at_once(self) -> bool:
        return bool(self._page.kept.get('at_once', True))

    def refresh(self) -> None:
        """Build the list anew where another node is chosen or a node has come back."""
        node = self._page.node
        shown = (node.name, tuple(node.controls)) if node else ()
        if shown != self._shown or not self._rows:
            self._shown = shown
            self._build(node)
        if self._rows and node is not None:
            self._list.props(remove='inert') if node.alive else self._list.props('inert')
            self.show_values()

    def _build(self, node: LiveNode | None) -> None:
        self._rows, self._stages = {}, {}
        self.element.clear()
        with self.element:
            if node is None or not node.controls:
                with box('card'):
                    empty('No parameters yet', 'They appear as soon as a node answers.')
                return
            with box('preview well').props('data-fresh=never'):
                canvas = box('image', 'canvas').props('role=img aria-label="Result"')
                canvas.props['data-key'] = f'{node.name} {RESULT_OF_KIND[node.kind]}'
            with box('card'):
                self._sets = SetBar(self._page, self.load, self.mark_differences)
                self._apply_bar()
                with box() as self._list:
                    self._build_list(node)
                self._more = button('', self._toggle_whole).props('flat').classes('more')

    def _apply_bar(self) -> None:
        with box('apply'):
            ui.switch('At once', value=self._at_once, on_change=self._switch).props('dense')
            self._undo = icon_button('undo', 'Undo', lambda: self._step(self._page.history.undo()))
            self._redo = icon_button('redo', 'Redo', lambda: self._step(self._page.history.redo()))
            box('grow')
            self._discard = button('Discard', self._forget_edits).props('flat')
            self._apply = button('Apply', self._apply_all, main=True)
        with box('filter'):
            self._filter = ui.input(placeholder='Find a parameter', on_change=self._arrange)
            self._filter.props('dense borderless clearable type=search')
            self._filter.props['aria-label'] = 'Find a parameter'

    def _build_list(self, node: LiveNode) -> None:
        with box('heads').props('aria-hidden=true'):
            text('parameter')
            text('now')
            text('new')
        controls = sorted(node.controls, key=lambda control: _rank(control.stage))
        for stage, group in groupby(controls, key=lambda control: control.stage):
            self._stages[stage] = text(stage, 'stage', tag='h2')
            for control in group:
                value = node.values.get(control.name)
                self._rows[control.name] = ParameterRow(
                    control, value, node.image_size, self._edited
                )

    def _arrange(self) -> None:
        """Show what counts now, or what is looked for."""
        node = self._page.node
        if node is None or not self._rows:
            return
        sought = str(self._filter.value or '')
        shown: dict[str, int] = {}
        hidden = 0
        for row in self._rows.values():
            stage, counts = row.control.stage, row.control.counts(node.values)
            wanted = row.matches(sought) if sought else counts and stage not in _FOLDED
            row.place(visible=wanted or (self._whole and not sought), counts=counts)
            shown[stage] = shown.get(stage, 0) + (wanted or (self._whole and not sought))
            hidden += not wanted and not sought
        for stage, label in self._stages.items():
            label.set_visibility(shown.get(stage, 0) > 0)
        self._more.set_visibility(hidden > 0)
        what = f'{hidden} that have no effect in this mode, or belong to the node'
        self._more.set_text(f'Hide {what}' if self._whole else f'Show {what}')

    def _toggle_whole(self) -> None:
        self._whole = not self._whole
        self._arrange()

    def show_values(self) -> None:
        """After the node's values changed, by us or by anybody."""
        node = self._page.node
        if node is None or not self._rows:
            return
        edits = self._page.edits
        for name, row in self._rows.items():
            row.show(node.values.get(name), edits.get(name))
        self.mark_differences()
        self._count_edits()

    def show_status(self) -> None:
        """After new diagnostics."""
        node = self._page.node
        if node is not None:
            for row in self._rows.values():
                row.fit(node.image_size)

    def edit(self, name: str, value: Value) -> None:
        """As if the user had entered a value."""
        if name in self._rows:
            self._edited(name, value)
            self.show_values()

    def _sets_changed(self) -> None:
        if self._rows:
            self._sets.reload()
            self.mark_differences()

    def mark_differences(self) -> None:
        """Mark the rows whose value is not the chosen set's."""
        if not self._rows:
            return
        values = self._page.own_values()
        chosen = self._sets.refresh(values)
        for name, row in self._rows.items():
            other = name in chosen and name in values and not same_value(chosen[name], values[name])
            words = f'{self._page.chosen_set}: {value_text(chosen.get(name))}'
            row.mark_difference(words if other else '')
        self._arrange()

    def _edited(self, name: str, value: Value) -> None:
        self._page.edits[name] = value
        self._count_edits()
        if self._at_once and name not in self._sending:
            asyncio.create_task(self._send(name))  # noqa: RUF006 - kept in _sending

    async def _send(self, name: str) -> None:
        """Set one parameter until its newest value has been judged."""
        self._sending.add(name)
        node, edits = self._page.selected, self._page.edits
        try:
            while name in edits:
                value = edits[name]
                refused = await self._set(node, {name: value})
                if same_value(edits.get(name), value):
                    if not refused:
                        del edits[name]
                    self._judge(node, {name: refused.get(name, '')})
                    break
        finally:
            self._sending.discard(name)

    async def _set(self, node: str, values: Mapping[str, Value]) -> dict[str, str]:
        """Set values, to be undone; returns the reason for each that was refused."""
        live = self._page.services.system.nodes.get(node)
        before = dict(live.values) if live is not None else {}
        history = self._page.history
        refused = await self._page.services.system.set(node, values)
        taken = {name: value for name, value in values.items() if name not in refused}
        history.record({name: before[name] for name in taken if name in before}, taken)
        return refused

    def _judge(self, node: str, reasons: Mapping[str, str]) -> None:
        """Show what the node said: reasons, empty where it has taken the value."""
        if node != self._page.selected:
            return
        self.show_values()
        for name, reason in reasons.items():
            if reason and name in self._rows:
                self._rows[name].refuse(reason)

    async def _apply_all(self) -> None:
        node, edits = self._page.selected, self._page.edits
        values = dict(edits)
        refused = await self._set(node, values)
        for name in values.keys() - refused.keys():
            edits.pop(name, None)
        self._judge(node, refused)

    async def _load(self, values: dict[str, Value]) -> dict[str, str]:
        node = self._page.node
        if node is None:
            return {}
        settable = {c.name for c in node.controls if not c.read_only}
        changes = {
            name: value
            for name, value in values.items()
            if name in settable and not same_value(node.values.get(name), value)
        }
        edits = self._page.edits
        edits.clear()
        refused = await self._set(node.name, changes) if changes else {}
        edits.update({name: changes[name] for name in refused})
        self._judge(node.name, refused)
        return refused

    async def load(self, values: Mapping[str, Value], name: str) -> None:
        """Give the node the values of a set or run."""
        refused = await self._load(dict(values))
        if refused:
            tell(
                f'{len(refused)} values of {name} were refused; the reasons are beside them',
                bad=True,
            )
        else:
            tell(f'{name} is loaded')

    async def _step(self, values: Mapping[str, Value]) -> None:
        node = self._page.selected
        for name in values:
            self._page.edits.pop(name, None)
        refused = await self._page.services.system.set(node, values) if values else {}
        self._judge(node, refused)

    def _forget_edits(self) -> None:
        self._page.edits.clear()
        self.show_values()

    def _switch(self, event: Any) -> None:
        self._page.kept['at_once'] = bool(event.value)
        if self._at_once:
            for name, value in list(self._page.edits.items()):
                self._edited(name, value)
        self._count_edits()

    def _count_edits(self) -> None:
        waiting = len(self._page.edits) if not self._at_once else 0
        self._apply.set_text(f'Apply {waiting}' if waiting else 'Apply')
        self._apply.set_enabled(waiting > 0)
        self._discard.set_enabled(bool(self._page.edits))
        self._undo.set_enabled(self._page.history.can_undo)
        self._redo.set_enabled(self._page.history.can_redo)


def _rank(stage: str) -> int:
    """In the order of the processing; a stage that we do not know comes behind it."""
    if stage in _STAGES:
        return _STAGES.index(stage)
    return len(_STAGES) + (1 + _LAST.index(stage) if stage in _LAST else 0)

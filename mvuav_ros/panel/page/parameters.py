"""The part with the chosen node's parameters."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from itertools import groupby
from typing import Any

from nicegui import ui

from mvuav_ros.panel.history import History
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

    @property
    def _history(self) -> History:
        return self._page.history_of(self._page.selected)

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
            self._undo = icon_button('undo', 'Undo', lambda: self._step(self._history.undo()))
            self._redo = icon_button('redo', 'Redo', lambda: self._step(self._history.redo()))
            box('grow')
            self._discard = button('Discard', self._forget_edits).props('flat')
            self._apply = button(
                'Apply', lambda: self._set(self._page.selected, dict(self._page.edits)), main=True
            )
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
        if node is None:
            return
        sought = str(self._filter.value or '')
        hidden, stages = 0, set()
        for row in self._rows.values():
            stage, counts = row.control.stage, row.control.counts(node.values)
            wanted = row.matches(sought) if sought else counts and stage not in _FOLDED
            hidden += not wanted
            visible = wanted or (self._whole and not sought)
            row.place(visible=visible, counts=counts)
            if visible:
                stages.add(stage)
        for stage, label in self._stages.items():
            label.set_visibility(stage in stages)
        self._more.set_visibility(hidden > 0 and not sought)
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
        if self._rows:
            differing = self._sets.compare(self._page.own_values())
            for name, row in self._rows.items():
                row.mark_difference(differing.get(name, ''))
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
                await self._set(node, {name: value})
                if same_value(edits.get(name), value):
                    break
        finally:
            self._sending.discard(name)

    async def _set(
        self, node: str, values: Mapping[str, Value], *, undoable: bool = True
    ) -> dict[str, str]:
        """Set values and show what the node says.

        Returns:
            The reason for each that it has refused; those stay edits.
        """
        live = self._page.services.system.nodes.get(node)
        before = dict(live.values) if live is not None else {}
        edits = self._page.edits_of(node)
        edits.update(values)
        refused = await self._page.services.system.set(node, values) if values else {}
        taken = {name: value for name, value in values.items() if name not in refused}
        if undoable:
            known = {name: before[name] for name in taken if name in before}
            self._page.history_of(node).record(known, taken)
        for name, value in taken.items():
            if same_value(edits.get(name), value):
                del edits[name]
        if node == self._page.selected:
            self.show_values()
            for name, reason in refused.items():
                if name in self._rows and same_value(edits.get(name), values[name]):
                    self._rows[name].refuse(reason)
        return refused

    async def load(self, values: Mapping[str, Value], name: str) -> None:
        """Give the node the values of a set or run."""
        node = self._page.node
        if node is None:
            return
        settable = {control.name for control in node.controls if not control.read_only}
        self._page.edits.clear()
        changes = {
            name: value
            for name, value in values.items()
            if name in settable and not same_value(node.values.get(name), value)
        }
        refused = len(await self._set(node.name, changes))
        if refused:
            tell(f'{refused} values of {name} were refused; the reasons are beside them', bad=True)
        else:
            tell(f'{name} is loaded')

    async def _step(self, values: Mapping[str, Value]) -> None:
        await self._set(self._page.selected, values, undoable=False)

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
        self._undo.set_enabled(self._history.can_undo)
        self._redo.set_enabled(self._history.can_redo)


def _rank(stage: str) -> int:
    """In the order of the processing; a stage that we do not know comes behind it."""
    if stage in _STAGES:
        return _STAGES.index(stage)
    return len(_STAGES) + (1 + _LAST.index(stage) if stage in _LAST else 0)

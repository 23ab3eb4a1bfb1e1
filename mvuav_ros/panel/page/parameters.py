"""The part with the chosen node's parameters."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from itertools import groupby
from typing import Any

from nicegui import background_tasks, ui

from mvuav_ros.panel.controls import Control
from mvuav_ros.panel.live_node import LiveNode, same_value
from mvuav_ros.panel.page import elements as el
from mvuav_ros.panel.page.context import Page
from mvuav_ros.panel.page.parameter_row import ParameterRow
from mvuav_ros.panel.page.set_bar import SetBar
from mvuav_ros.parameters.declaration import Value

_STAGES = [
    'Mode',
    'Image',
    'Edges',
    'Hough',
    'Detection',
    'Tracking',
    'Pose',
    'Approach',
    'Integrity',
]
_STAGES += ['unknown', 'Correction', 'Other', 'Node', 'Every ROS node']
"""In the order of the processing; a stage that we do not know comes where ``unknown`` stands."""
_FOLDED = ['Node', 'Every ROS node']


class Parameters:
    """Every parameter of a node with its control; edits go there at once or on a button.

    At once means: one request at a time with the newest values, so that a slow node or link is
    never behind by more than one.
    """

    def __init__(self, page: Page, node: LiveNode) -> None:
        self._page, self._node = page, node
        self._edits, self._history = page.edits_of(node.name), page.histories[node.name]
        self._rows: dict[str, ParameterRow] = {}
        self._sending: set[str] = set()
        self._stages: dict[str, ui.expansion] = {}
        self._whole = self._arranging = False
        with el.box('card'):
            self._sets = SetBar(page, node, self.load, self.show)
            self._build_bar()
            with el.box() as self._list:
                self._build_list()
            self._more = el.button('', self._toggle_whole).props('flat').classes('more')
        self.show_status()
        self.show()

    @property
    def _at_once(self) -> bool:
        return bool(self._page.kept.get('at_once', True))

    def _build_bar(self) -> None:
        with el.box('apply'):
            ui.switch('At once', value=self._at_once, on_change=self._switch).props('dense')
            self._undo = el.icon_button('undo', 'Undo', self.undo)
            self._redo = el.icon_button('redo', 'Redo', self.redo)
            el.box('grow')
            self._discard = el.button('Discard', self._forget_edits).props('flat')
            self._apply = el.button('Apply', lambda: self._set(dict(self._edits)), main=True)
        with el.box('filter'):
            self._filter = ui.input(placeholder='Find a parameter', on_change=self._arrange)
            self._filter.props('dense borderless clearable type=search')
            self._filter.props('aria-label="Find a parameter"').classes('grow')
            self._changed = ui.switch('Changed only', on_change=self._arrange).props('dense')

    def _build_list(self) -> None:
        with el.box('heads').props('aria-hidden=true'):
            for head in ('parameter', 'now', 'new'):
                el.text(head)
        controls = sorted(self._node.controls, key=_rank)
        for stage, group in groupby(controls, key=lambda control: control.stage):
            # Goes away with its last visible row; see the style sheet.
            with ui.expansion(stage).classes('stage-rows').props('dense') as rows:
                for each in group:
                    value = self._node.values.get(each.name)
                    self._rows[each.name] = ParameterRow(each, value, self._edited)
            rows.on_value_change(partial(self._fold, stage))
            self._stages[stage] = rows

    def _arrange(self) -> None:
        """Show what counts now, or what is looked for, whose groups are open."""
        sought, changed = str(self._filter.value or ''), bool(self._changed.value)
        looking, hidden = bool(sought) or changed, 0
        for row in self._rows.values():
            counts = row.control.counts(self._node.values)
            wanted = (row.matches(sought) and row.changed >= changed) if looking else counts
            hidden += not wanted
            row.place(visible=wanted or (self._whole and not looking), counts=counts)
        self._arranging = True
        for stage, rows in self._stages.items():
            rows.value = looking or stage not in self._folded
        self._arranging = False
        self._more.set_visibility(hidden > 0 and not looking)
        what = f'{hidden} that have no effect in this mode'
        self._more.set_text(f'Hide {what}' if self._whole else f'Show {what}')

    @property
    def _folded(self) -> list[str]:
        folded: list[str] = self._page.kept.setdefault('folded', list(_FOLDED))
        return folded

    def _fold(self, stage: str, event: Any) -> None:
        """Keep what the user folds and unfolds."""
        if not self._arranging:
            others = [each for each in self._folded if each != stage]
            self._page.kept['folded'] = others if event.value else [*others, stage]

    def find(self) -> None:
        """Let the user type what he looks for."""
        self._filter.run_method('focus')

    async def undo(self) -> None:
        """Take back the last change."""
        await self._step(self._history.undo())

    async def redo(self) -> None:
        """Do again what was taken back last."""
        await self._step(self._history.redo())

    def _toggle_whole(self) -> None:
        self._whole = not self._whole
        self._arrange()

    def show(self) -> None:
        """After the node's values changed, by us or by anybody, or it came or went."""
        values, differing = self._node.values, self._sets.compare()
        for name, row in self._rows.items():
            base = self._sets.value_of(name)
            row.show(values.get(name), self._edits.get(name), differing.get(name, ''), base)
        self._list.props(remove='inert') if self._node.alive else self._list.props('inert')
        self._arrange()
        self._count_edits()

    def show_status(self) -> None:
        """After new diagnostics."""
        for row in self._rows.values():
            row.fit(self._node.image_size)

    def show_sets(self) -> None:
        """After a set was saved, taken in or deleted."""
        self._sets.reload()
        self.show()

    def edit(self, name: str, value: Value) -> None:
        """As if the user had entered a value."""
        if name in self._rows:
            self._edited(name, value)
            self.show()

    def _edited(self, name: str, value: Value) -> None:
        self._edits[name] = value
        self._count_edits()
        if self._at_once and name not in self._sending:
            background_tasks.create(self._send(name))

    async def _send(self, name: str) -> None:
        """Set one parameter until its newest value has been judged."""
        self._sending.add(name)
        try:
            while name in self._edits:
                value = self._edits[name]
                await self._set({name: value})
                if same_value(self._edits.get(name), value):
                    break
        finally:
            self._sending.discard(name)

    async def _set(self, values: Mapping[str, Value], *, undoable: bool = True) -> dict[str, str]:
        """Set values; returns the reason for each that the node refused, which stays an edit."""
        before = dict(self._node.values)
        self._edits.update(values)
        system = self._page.services.system
        refused = await system.set(self._node, values) if values else {}
        taken = {name: value for name, value in values.items() if name not in refused}
        if undoable:
            self._history.record({name: before[name] for name in taken if name in before}, taken)
        for name, value in taken.items():
            if same_value(self._edits.get(name), value):
                del self._edits[name]
        # Another list may show the node by now.
        system.tell('values', self._node)
        for name, reason in refused.items() if not self._list.is_deleted else ():
            if name in self._rows and same_value(self._edits.get(name), values[name]):
                self._rows[name].refuse(reason)
        return refused

    async def load(self, values: Mapping[str, Value], name: str) -> None:
        """Give the node the values of a set or run."""
        self._edits.clear()
        settable = {control.name for control in self._node.controls if not control.read_only}
        changes = {
            name: value
            for name, value in values.items()
            if name in settable and not same_value(self._node.values.get(name), value)
        }
        refused = len(await self._set(changes))
        if refused:
            el.tell(f'{refused} values of {name} were refused; each line says why', bad=True)
        else:
            el.tell(f'{name} is loaded')

    async def _step(self, values: Mapping[str, Value]) -> None:
        await self._set(values, undoable=False)

    def _forget_edits(self) -> None:
        self._edits.clear()
        self.show()

    def _switch(self, event: Any) -> None:
        self._page.kept['at_once'] = bool(event.value)
        if self._at_once:
            for name, value in list(self._edits.items()):
                self._edited(name, value)
        self._count_edits()

    def _count_edits(self) -> None:
        waiting = len(self._edits) if not self._at_once else 0
        self._apply.set_text(f'Apply {waiting}' if waiting else 'Apply')
        self._apply.set_enabled(waiting > 0)
        self._discard.set_enabled(bool(self._edits))
        self._undo.set_enabled(bool(self._history.done))
        self._redo.set_enabled(bool(self._history.undone))


def _rank(control: Control) -> int:
    return _STAGES.index(control.stage if control.stage in _STAGES else 'unknown')

"""The part with the chosen node's parameters: one row each, and what is done with all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, MutableMapping
from functools import partial
from itertools import groupby
from typing import Any

from nicegui import background_tasks, ui

from mvuav_ros.panel import sanitized
from mvuav_ros.panel.controls import EVERY_NODE, OTHER, Control, position_on, scale_of, value_text
from mvuav_ros.panel.live_nodes import LiveNode, same_value
from mvuav_ros.panel.page import elements as el
from mvuav_ros.panel.page.context import Page
from mvuav_ros.panel.page.set_bar import SetBar
from mvuav_ros.parameters.declaration import Value
from mvuav_ros.processing.registry import PROCESSORS


class ParameterRow:
    """A parameter's line of the list; ``edited`` is called whenever the user has changed the value.

    It is ``changed`` where the node's value is not that of the chosen set, or not the default.
    What the user is typing is never overwritten, whoever changes the parameter meanwhile.
    """

    def __init__(
        self, control: Control, value: Any, edited: Callable[[str, Value], object]
    ) -> None:
        self.control, self._edited = control, edited
        self._label = sanitized.words(control.name)
        self._current: Any = value
        self._new: Any = value
        self._base: Any = None
        self.changed = False
        self._refused = self._difference = ''
        self._slider: ui.element | None = None
        thesis = f' Thesis: {control.thesis}.' if control.thesis else ''
        self._description = (control.description or 'No description.') + thesis
        with el.box(f'param of-{control.kind}') as self._row:
            el.set_props(self._row, data_parameter=self._label)
            with el.box('named'):
                _show_name(self._label, self._description)
                self._reset = el.icon_button(
                    'settings_backup_restore', 'Reset', lambda: self._enter(self._base)
                )
                el.set_props(self._reset, aria_label=f'Reset {self._label}')
            self._now = el.text(value_text(value), 'now')
            with el.box('edit'):
                self._field = self._make_field()
            if control.kind == 'slider' and not control.read_only:
                self._slider = el.slider(self._label, self._moved, control.unit)
            self._hint = el.text('', 'hint').props('aria-live=polite')

    def _make_field(self) -> Any:
        control = self.control
        field: Any
        if control.kind == 'switch':
            field = ui.switch(value=self._written, on_change=self._chosen).props('dense')
        elif control.kind == 'menu':
            # A node's value may be none of the choices.
            options = list(dict.fromkeys((*control.choices, self._new)))
            field = ui.select(options, value=self._new, on_change=self._chosen)
            field.props('outlined dense options-dense')
        else:
            field = ui.input(value=self._written).props('outlined dense')
            if control.type in (int, float):
                field.props('inputmode=decimal')
            field.on('keydown.enter', self._commit).on('blur', self._commit)
            field.on('keydown.esc', self._give_up)
        el.set_props(field, aria_label=f'{self._label}, new value')
        # What cannot be typed as it is must not be changed by being looked at.
        unlike = control.type is tuple or sanitized.words(self._new) != self._new
        if control.read_only or (isinstance(self._new, str) and unlike):
            field.disable()
        return field

    @property
    def _written(self) -> Any:
        """The new value as the field holds it while nobody types."""
        if self.control.kind == 'switch':
            return bool(self._new)
        return (
            self._new if self.control.kind == 'menu' or self._new == '' else value_text(self._new)
        )

    def matches(self, words: str) -> bool:
        """Whether every typed word occurs in name, description or thesis."""
        said = f'{self._label} {self._description} {self.control.stage}'.lower()
        return all(word in said for word in words.lower().split())

    def place(self, *, visible: bool, counts: bool) -> None:
        """Show or hide the line; one that does not count is drawn back."""
        self._row.set_visibility(visible)
        el.set_class(self._row, 'idle', not counts)

    def fit(self, image_size: int) -> None:
        """Let a slider for places and lengths end where the image does; see `scale_of`."""
        if self._slider is not None:
            self._scale = scale_of(self.control, image_size)
            shown = ' '.join(map(value_text, self._scale))
            el.set_props(self._slider, max=len(self._scale) - 1, data_values=shown)
            self._say()

    def show(self, value: Any, edit: Value | None, difference: str, base: Value | None) -> None:
        """Show the node's value, and beside it the user's where the node has not taken that.

        A value that is not the chosen set's is marked; ``difference`` says what that has.
        ``base`` is that set's value, to which it is reset; without one it is the default.
        """
        default = self.control.default if self.control.declared else None
        self._base = default if base is None else base
        self._current, now = value, value_text(value)
        self.changed = self._base is not None and now != value_text(self._base)
        self._reset.set_visibility(self.changed and not self.control.read_only)
        self._now.set_text(now)
        self._difference = difference
        self._show_new(value if edit is None else edit, self._refused if edit is not None else '')

    def refuse(self, reason: str) -> None:
        """Show why the edited value was not taken; it stays in its field."""
        self._refused = sanitized.words(reason)
        self._say()

    def _show_new(self, value: Any, refused: str = '') -> None:
        is_typing = not same_value(self._field.value, self._written)
        self._new, self._refused = value, refused
        if not is_typing:
            self._write()
        self._say()

    def _write(self) -> None:
        if self.control.kind == 'menu' and self._new not in self._field.options:
            self._field.set_options([*self.control.choices, self._new], value=self._new)
        elif not same_value(self._field.value, self._written):
            self._field.value = self._written

    def _enter(self, value: Value) -> None:
        self._show_new(value)
        self._edited(self.control.name, value)

    def _moved(self, position: int) -> None:
        if 0 <= position < len(self._scale):
            self._enter(self._scale[position])

    def _chosen(self, event: Any) -> None:
        if not same_value(event.value, self._written):
            self._enter(event.value)

    def _commit(self) -> None:
        if self._field.value == self._written:
            self._give_up()
            return
        try:
            value = self.control.parse(self._field.value)
        except ValueError as error:
            self.refuse(str(error))
            return
        if not same_value(value, self._new):
            self._enter(value)
        self._write()

    def _give_up(self) -> None:
        """What was typed counts no more, nor why it could not be a value."""
        self._write()
        if same_value(self._new, self._current):
            self.refuse('')

    def _say(self) -> None:
        """The slider's thumb, and the line below: the node's reason, or range, unit and default."""
        control = self.control
        # What is no number has no place.
        if self._slider is not None and isinstance(self._new, (int, float)):
            el.set_props(self._slider, data_index=position_on(self._scale, self._new))
        words = [self._difference, '' if control.kind == 'menu' else control.constraint]
        words += [control.unit]
        words += [f'default {value_text(control.default)}'] if control.declared else []
        words += ['set at the start only'] if control.read_only else []
        plain = ' · '.join(word for word in words if word)
        self._hint.set_text(self._refused or sanitized.words(plain or control.description))
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


class Parameters:
    """Every parameter of a node with its control; edits go there at once or on a button.

    At once means: one request at a time with the newest values, so that a slow node or link is
    never behind by more than one.
    """

    def __init__(self, page: Page, node: LiveNode) -> None:
        self._page, self._node = page, node
        self._history = page.histories[node.name]
        self._edits: MutableMapping[str, Value] = page.kept['edits'].setdefault(node.name, {})
        self._rows: dict[str, ParameterRow] = {}
        self._sending: set[str] = set()
        self._stages: dict[str, ui.expansion] = {}
        self._whole, self._image_size = False, -1
        with el.box('card'):
            self._sets = SetBar(page, node, self.load, self.show)
            self._build_bar()
            with el.box() as self._list:
                self._build_list()
            self._more = el.button('', self._toggle_whole).props('flat').classes('more')
        self.show_status()
        self.show()

    def _build_bar(self) -> None:
        with el.box('apply'):
            kept = self._page.kept['at_once']
            self._at_once = ui.switch('At once', value=kept, on_change=self._switch).props('dense')
            self._undo = el.icon_button('undo', 'Undo', lambda: self.step(back=True))
            self._redo = el.icon_button('redo', 'Redo', lambda: self.step(back=False))
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
        declared = PROCESSORS[self._node.kind].parameters_type.specs()
        stages = [*dict.fromkeys(spec.stage for spec in declared), OTHER, EVERY_NODE]
        controls = sorted(self._node.controls, key=lambda control: stages.index(control.stage))
        for stage, group in groupby(controls, key=lambda control: control.stage):
            # Goes away with its last visible row; see the style sheet.
            with ui.expansion(stage).classes('stage-rows').props('dense') as rows:
                for each in group:
                    value = self._node.values.get(each.name)
                    self._rows[each.name] = ParameterRow(each, value, self._edited)
            # What the user folds and unfolds; the value itself also follows the search.
            rows.on('update:model-value', partial(self._fold, stage))
            self._stages[stage] = rows

    def _arrange(self) -> None:
        """Show what counts now, or what is looked for, whose groups are open."""
        sought, changed = str(self._filter.value or ''), bool(self._changed.value)
        looking, hidden = bool(sought) or changed, 0
        for row in self._rows.values():
            counts = row.control.has_effect(self._node.values)
            wanted = (row.matches(sought) and row.changed >= changed) if looking else counts
            hidden += not wanted
            row.place(visible=wanted or (self._whole and not looking), counts=counts)
        for stage, rows in self._stages.items():
            rows.value = looking or stage not in self._page.kept['folded']
        self._more.set_visibility(hidden > 0 and not looking)
        verb = 'Hide' if self._whole else 'Show'
        self._more.set_text(f'{verb} {hidden} that have no effect in this mode')

    def _fold(self, stage: str, event: Any) -> None:
        others = [each for each in self._page.kept['folded'] if each != stage]
        self._page.kept['folded'] = others if event.args else [*others, stage]

    def find(self) -> None:
        """Let the user type what he looks for."""
        self._filter.run_method('focus')

    async def step(self, *, back: bool) -> None:
        """Take back the last change, or do again what was taken back last."""
        if await self._set(self._history.step(back=back), undoable=False):
            self._history.step(back=not back)
            self._count_edits()

    def _toggle_whole(self) -> None:
        self._whole = not self._whole
        self._arrange()

    def show(self) -> None:
        """After the node's values changed, by us or by anybody, or it came or went."""
        values, differing = self._node.values, self._sets.compare()
        for name, row in self._rows.items():
            base, difference = self._sets.values.get(name), differing.get(name, '')
            row.show(values.get(name), self._edits.get(name), difference, base)
        self._list.props(remove='inert') if self._node.alive else self._list.props('inert')
        self._arrange()
        self._count_edits()

    def show_status(self) -> None:
        """After new diagnostics."""
        if self._image_size != self._node.image_size:
            self._image_size = self._node.image_size
            for row in self._rows.values():
                row.fit(self._image_size)

    def appear(self) -> None:
        """After its node was selected again: what changed meanwhile is on this list, too."""
        self._at_once.value = self._page.kept['at_once']
        self.show_status()
        self.show_sets()

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
        if self._page.kept['at_once'] and name not in self._sending:
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
        system.notify('values', self._node)
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
            were = 'value was' if refused == 1 else 'values were'
            el.notify(f'{refused} {were} refused from {name}; the lines say why', bad=True)
        else:
            el.notify(f'{name} is loaded')

    def _forget_edits(self) -> None:
        self._edits.clear()
        self.show()

    def _switch(self, event: Any) -> None:
        self._page.kept['at_once'] = bool(event.value)
        if event.value:
            for name, value in list(self._edits.items()):
                self._edited(name, value)
        self._count_edits()

    def _count_edits(self) -> None:
        waiting = 0 if self._page.kept['at_once'] else len(self._edits)
        self._apply.set_text(f'Apply {waiting}' if waiting else 'Apply')
        self._apply.set_enabled(waiting > 0)
        self._discard.set_enabled(bool(self._edits))
        self._undo.set_enabled(bool(self._history.done))
        self._redo.set_enabled(bool(self._history.undone))

"""How a parameter is set by hand, from its ROS descriptor alone."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, ParameterType

from mvuav_ros.parameters.declaration import Value

_CHOICES = 'one of '
_DESCRIPTION = re.compile(r'(.*?)(?: Unit: (.*?)\.)?(?: Thesis: (.*)\.)?', re.DOTALL)
_LARGEST_LINEAR = 400
"""Positions of a slider that a hand can still tell apart."""
_DIGITS = 3
_SAFE_TYPES = {
    ParameterType.PARAMETER_BOOL: bool,
    ParameterType.PARAMETER_INTEGER: int,
    ParameterType.PARAMETER_DOUBLE: float,
    ParameterType.PARAMETER_STRING: str,
}


class Kind(Enum):
    """The widget."""

    SWITCH = 'switch'
    MENU = 'menu'
    SLIDER = 'slider'
    NUMBER = 'number'
    TEXT = 'text'


@dataclass(frozen=True)
class Control:
    """A parameter's widget and its words.

    Attributes:
        name: the parameter's.
        kind: of the widget.
        type: of the value; None of one that the panel only shows (a list).
        description: without unit and thesis.
        unit: empty where it has none.
        thesis: the thesis's name or value of it.
        constraint: the values allowed, in words.
        minimum: of a slider, as the descriptor says.
        maximum: the same.
        choices: of a menu.
        odd: only odd numbers are allowed.
        read_only: it cannot be changed while the node runs.
    """

    name: str
    kind: Kind
    type: type | None
    description: str = ''
    unit: str = ''
    thesis: str = ''
    constraint: str = ''
    minimum: float = 0.0
    maximum: float = 0.0
    choices: tuple[str, ...] = ()
    odd: bool = False
    read_only: bool = False

    @property
    def foreign(self) -> bool:
        """Whether every ROS node has it, without a meaning for vision."""
        return self.name.startswith('qos_overrides.') or self.name in (
            'use_sim_time',
            'start_type_description_service',
        )

    def parse(self, text: object) -> Value:
        """What a user typed, as a value to be sent to the node, which judges it.

        Raises:
            ValueError: it is not even of the type.
        """
        if self.type is bool:
            return bool(text)
        if self.type is str:
            return '' if text is None else str(text)
        number = float(str(text).strip().replace(',', '.'))
        if self.type is int:
            if not math.isfinite(number) or number != int(number):
                raise ValueError(f'{self.name} takes a whole number')
            return int(number)
        return number


@dataclass(frozen=True)
class Scale:
    """Positions 0 to 1 of a slider and the values there.

    A range too wide for a hand is spread logarithmically from its lower end.
    """

    minimum: float
    maximum: float
    whole: bool
    odd: bool = False

    @property
    def _span(self) -> float:
        return max(self.maximum - self.minimum, 1e-12)

    @property
    def _logarithmic(self) -> bool:
        return self._span > _LARGEST_LINEAR * (10 if self.whole else 1)

    def value(self, position: float) -> float | int:
        """The value at a position, rounded to what a hand can mean."""
        position = min(max(position, 0.0), 1.0)
        if self._logarithmic:
            value = self.minimum + math.expm1(position * math.log1p(self._span))
        else:
            value = self.minimum + position * self._span
        if self.whole:
            return self._nearest(value)
        digits = _DIGITS - math.ceil(math.log10(self._span))
        if self._logarithmic and value > 0:
            digits = _DIGITS - 1 - math.floor(math.log10(value))
        return min(max(round(value, max(digits, 0)), self.minimum), self.maximum)

    def position(self, value: float) -> float:
        """Where a value lies."""
        inside = min(max(value, self.minimum), self.maximum) - self.minimum
        if self._logarithmic:
            return math.log1p(inside) / math.log1p(self._span)
        return inside / self._span

    def _nearest(self, value: float) -> int:
        if not self.odd:
            return round(value)
        return int(min(max(2 * math.floor(value / 2) + 1, self.minimum), self.maximum))

    def within(self, size: float) -> Scale:
        """The scale for positions and lengths in a image of that size, px."""
        if size <= 0 or self.maximum <= size:
            return self
        return replace(self, maximum=max(size, self.minimum + 1))


def scale_of(control: Control) -> Scale:
    """A slider's scale over the whole range of its parameter."""
    return Scale(control.minimum, control.maximum, control.type is int, control.odd)


def control_of(descriptor: ParameterDescriptor) -> Control:
    """The control that fits a descriptor; of other packages' nodes as well."""
    words = _DESCRIPTION.fullmatch(descriptor.description)
    description, unit, thesis = words.groups() if words else (descriptor.description, '', '')
    constraint = str(descriptor.additional_constraints)
    kind, more = _kind(descriptor, constraint)
    return Control(
        name=str(descriptor.name),
        kind=kind,
        type=_SAFE_TYPES.get(descriptor.type),
        description=description.strip(),
        unit=unit or '',
        thesis=thesis or '',
        constraint=constraint,
        odd=constraint.startswith('odd'),
        read_only=bool(descriptor.read_only) or descriptor.type not in _SAFE_TYPES,
        **more,
    )


def _kind(descriptor: ParameterDescriptor, constraint: str) -> tuple[Kind, dict[str, Any]]:
    if descriptor.type == ParameterType.PARAMETER_BOOL:
        return Kind.SWITCH, {}
    if descriptor.type == ParameterType.PARAMETER_STRING:
        if constraint.startswith(_CHOICES):
            return Kind.MENU, {'choices': tuple(constraint.removeprefix(_CHOICES).split(', '))}
        return Kind.TEXT, {}
    ranges = [*descriptor.integer_range, *descriptor.floating_point_range]
    numeric = descriptor.type in (ParameterType.PARAMETER_INTEGER, ParameterType.PARAMETER_DOUBLE)
    if not numeric:
        return Kind.TEXT, {}
    if not ranges:
        return Kind.NUMBER, {}
    limits = {'minimum': float(ranges[0].from_value), 'maximum': float(ranges[0].to_value)}
    return Kind.SLIDER, limits


def value_text(value: object) -> str:
    """A value as the panel writes it."""
    if value is None:
        return '-'
    if isinstance(value, bool):
        return 'on' if value else 'off'
    if isinstance(value, float):
        return f'{value:.6g}'
    if isinstance(value, str):
        return value or '(empty)'
    return str(value)

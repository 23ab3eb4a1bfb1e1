"""How a parameter is set by hand, from its ROS descriptor alone."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, ParameterType

from mvuav_ros.panel import sanitized
from mvuav_ros.parameters.declaration import DescriptorText, Value, default_text, read_description
from mvuav_ros.parameters.parameter_file import is_every_nodes

_CHOICES = 'one of '
_LOGARITHMIC = 40
"""A range whose ends have at least this ratio is spread logarithmically."""
_MAX_STEPS = 500
"""Positions of a slider that a hand can still distinguish."""
_MAX_RANGE = 1e15
"""Ends of a range that is a range: beyond that any number is allowed."""
_SHORT = 40
_MAX_INTEGER = 2**63 - 1
_BETWEEN = re.compile(r'[,;\s()\[\]]+')
"""Several numbers."""
_TYPES = {
    ParameterType.PARAMETER_BOOL: bool,
    ParameterType.PARAMETER_INTEGER: int,
    ParameterType.PARAMETER_DOUBLE: float,
    ParameterType.PARAMETER_STRING: str,
    ParameterType.PARAMETER_DOUBLE_ARRAY: tuple,
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
    """A parameter's widget and its words; see `ParameterSpec`.

    ``type`` is None of one that the panel only shows, a tuple is of numbers; ``text`` is what the
    descriptor's description says. Ends that the descriptor does not say are NaN.
    """

    name: str
    kind: Kind
    type: type | None
    text: DescriptorText
    constraint: str = ''
    minimum: float = math.nan
    maximum: float = math.nan
    choices: tuple[str, ...] = ()
    odd: bool = False
    read_only: bool = False

    @property
    def is_every_nodes(self) -> bool:
        """Whether every ROS node has it, without a meaning for vision."""
        return is_every_nodes(self.name)

    @property
    def stage(self) -> str:
        """Of the processing."""
        return 'Every ROS node' if self.is_every_nodes else self.text.stage or 'Other'

    @property
    def label(self) -> str:
        """The name for people."""
        return sanitized.words(self.name)

    @property
    def default(self) -> Value | None:
        """What its description says; None where that is nothing."""
        said = self.text.default
        if self.type is bool:
            return said == 'on' if said else None
        if self.type is str:
            return '' if said == '(empty)' else said or None
        with suppress(ValueError):
            return self.parse(said) if said and self.type is not None else None
        return None

    def counts(self, values: Mapping[str, Any]) -> bool:
        """Whether it has an effect while the node's parameters have these values."""
        return not self.text.counts or any(
            all(str(values.get(name)) in wanted for name, wanted in condition.items())
            for condition in self.text.counts
        )

    def parse(self, words: object) -> Value:
        """What a user typed, as a value for the node to judge; ValueError where it can be none."""
        if self.type is bool:
            return bool(words)
        if self.type is str:
            return '' if words is None else str(words)
        if self.type is tuple:
            parts = [part for part in _BETWEEN.split(str(words)) if part]
            return tuple(_number(part, 'numbers') for part in parts or [''])
        whole = self.type is int
        plain = str(words).strip().replace(',', '.')
        number = _number(plain, 'a whole number' if whole else 'a number')
        if not whole:
            return number
        if number != int(number) or abs(number) > _MAX_INTEGER:
            raise ValueError(f'takes a whole number, not {number:g}')
        return int(number)


def _number(words: str, wanted: str) -> float:
    try:
        number = float(words)
    except ValueError:
        raise ValueError(f'takes {wanted}') from None
    if not math.isfinite(number):
        raise ValueError(f'must be a finite number, not {number}')
    return number


def scale_of(control: Control, image_size: float = 0.0) -> tuple[float, ...]:
    """The values at a slider's positions, rising, over the range usual for its parameter.

    Places and lengths in the image end at the longer side of the node's images (px; 0: not known).
    """
    low, high = control.text.usual or (control.minimum, control.maximum)
    low, high = max(low, control.minimum), min(high, control.maximum)
    if low >= high:
        low, high = control.minimum, control.maximum
    if control.text.unit == 'px' and image_size > 0 and control.text.usual:
        high = min(high, max(image_size, low + 1))
    whole = control.type is int
    if low > 0 and high / low >= _LOGARITHMIC:
        values = _two_digits(low, high, whole)
    else:
        step = _step((high - low) / _MAX_STEPS, whole)
        count = math.floor((high - low) / step + 1e-9)
        values = [round(low + step * index, 10) for index in range(count + 1)]
    if control.odd:
        values = sorted({2 * (int(value) // 2) + 1 for value in values} - {int(high) + 1})
    return tuple(int(value) if whole else value for value in values)


def position_on(scale: Sequence[float], value: float) -> int:
    """The position on a slider's scale whose value is nearest."""
    value = min(max(value, scale[0]), scale[-1])
    return min(range(len(scale)), key=lambda index: abs(scale[index] - value))


def _step(least: float, whole: bool) -> float:
    """The next of 1, 2 and 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(least))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= least * 0.999)
    return max(step, 1.0) if whole else step


def _two_digits(low: float, high: float, whole: bool) -> list[float]:
    """All numbers of two digits, with any power of ten, from ``low`` to ``high``."""
    values = {low, high}
    for exponent in range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1):
        values |= {round(digits * 10.0 ** (exponent - 1), 10) for digits in range(10, 100)}
    return sorted(v for v in values if low <= v <= high and (not whole or v == int(v)))


def control_of(descriptor: ParameterDescriptor) -> Control:
    """The control that fits a descriptor; of other packages' nodes as well."""
    text = read_description(sanitized.words(descriptor.description, sanitized.LONGEST_DESCRIPTION))
    short: dict[str, Any] = {
        n: sanitized.words(getattr(text, n), _SHORT) for n in ('unit', 'default', 'stage')
    }
    text = replace(text, thesis=sanitized.words(text.thesis), **short)
    constraint = sanitized.words(descriptor.additional_constraints, sanitized.LONGEST_DESCRIPTION)
    type_ = _TYPES.get(descriptor.type)
    choices: tuple[str, ...] = ()
    kind, minimum, maximum = Kind.TEXT, math.nan, math.nan
    if type_ is bool:
        kind = Kind.SWITCH
    elif type_ is str and constraint.startswith(_CHOICES):
        kind, choices = Kind.MENU, tuple(constraint.removeprefix(_CHOICES).split(', '))
    elif type_ in (int, float):
        kind = Kind.NUMBER
        for each in (*descriptor.integer_range, *descriptor.floating_point_range):
            low, high = float(each.from_value), float(each.to_value)
            if -_MAX_RANGE < low < high < _MAX_RANGE:
                kind, minimum, maximum = Kind.SLIDER, low, high
    return Control(
        name=str(descriptor.name),
        kind=kind,
        type=type_,
        text=text,
        constraint=constraint,
        minimum=minimum,
        maximum=maximum,
        choices=choices,
        odd=constraint.startswith('odd'),
        read_only=bool(descriptor.read_only) or type_ is None,
    )


def value_text(value: object) -> str:
    """A value as the panel writes it."""
    if value is None:
        return '-'
    if isinstance(value, (bool, int, float, str, tuple)):
        return sanitized.words(default_text(value))
    return sanitized.words(value)

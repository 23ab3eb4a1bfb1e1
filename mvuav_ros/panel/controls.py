"""How a parameter is set by hand, by what its node's kind declares of it."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from mvuav_ros.panel import sanitized
from mvuav_ros.parameters.declaration import ParameterSet, ParameterSpec, Value, default_text
from mvuav_ros.parameters.parameter_file import is_every_nodes

_LOGARITHMIC = 40
"""A range whose ends have at least this ratio is spread logarithmically."""
_MAX_STEPS = 500
"""Positions of a slider that a hand can still distinguish."""
_MAX_INTEGER = 2**63 - 1
_BETWEEN = re.compile(r'[,;\s()\[\]]+')
"""Several numbers."""
EVERY_NODE, OTHER = 'Every ROS node', 'Other'
"""Stages of what is not declared; what every node has is without a meaning for vision."""


@dataclass(frozen=True)
class Control(ParameterSpec):
    """A parameter as the panel sets it.

    One that is not ``declared`` has a type only, that of its value, which stands for the default.
    """

    declared: bool = True

    @property
    def kind(self) -> Literal['switch', 'menu', 'slider', 'number', 'text']:
        """The widget."""
        if self.type is bool:
            return 'switch'
        if self.type in (int, float):
            return 'slider' if self.usual else 'number'
        return 'menu' if self.choices else 'text'

    def parse(self, words: object) -> Value:
        """What a user typed, as a value for the node to judge; ValueError where it can be none."""
        if self.type is str:
            return '' if words is None else str(words)
        if self.type is tuple:
            parts = [part for part in _BETWEEN.split(str(words)) if part]
            return tuple(_number(part, 'numbers') for part in parts or [''])
        plain = str(words).strip()
        if self.type is not int:
            return _number(plain.replace(',', '.'), 'a number')
        number = _number(plain, 'a whole number')
        if number != int(number) or abs(number) > _MAX_INTEGER:
            raise ValueError(f'takes a whole number, not {number:g}')
        return int(number)


def controls_of(declared: type[ParameterSet], values: Mapping[str, Any]) -> list[Control]:
    """The controls of a node's parameters, in the order of their values."""
    specs = {spec.name: Control(**vars(spec)) for spec in declared.specs()}
    return [specs.get(name) or _undeclared(name, value) for name, value in values.items()]


def _undeclared(name: str, value: Any) -> Control:
    stage = EVERY_NODE if is_every_nodes(name) else OTHER
    # Of what every node has, the clock alone can be chosen while it runs.
    fixed = value is None or (stage == EVERY_NODE and name != 'use_sim_time')
    known = '' if value is None else value
    return Control(name, known, '', stage=stage, read_only=fixed, declared=False)


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
    assert control.usual is not None
    low, high = control.usual
    if control.unit == 'px' and image_size > 0:
        high = min(high, max(image_size, low + 1))
    whole = control.type is int
    if low > 0 and high / low >= _LOGARITHMIC:
        # All numbers of two digits, with any power of ten.
        exponents = range(math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)))
        rounded = {round(digits * 10.0**e, 10) for e in exponents for digits in range(10, 100)}
        between = (v for v in rounded | {low, high} if low <= v <= high)
        values = sorted(v for v in between if not whole or v == int(v))
    else:
        least = (high - low) / _MAX_STEPS
        power = 10.0 ** math.floor(math.log10(least))
        step = next(each * power for each in (1, 2, 5, 10) if each * power >= least * 0.999)
        step = max(step, 1.0) if whole else step
        count = math.floor((high - low) / step + 1e-9)
        values = [round(low + step * index, 10) for index in range(count + 1)]
    if control.odd:
        values = sorted({2 * (int(value) // 2) + 1 for value in values} - {int(high) + 1})
    return tuple(int(value) if whole else value for value in values)


def position_on(scale: Sequence[float], value: float) -> int:
    """The position on a slider's scale whose value is nearest."""
    value = min(max(value, scale[0]), scale[-1])
    return min(range(len(scale)), key=lambda index: abs(scale[index] - value))


def value_text(value: Any) -> str:
    """A value as the panel writes it."""
    return '-' if value is None else sanitized.words(default_text(value))

"""Declaring a node's parameters as the fields of one frozen dataclass.

ROS descriptors, the checks of YAML files and the reference pages are all made from them.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from difflib import get_close_matches
from typing import Any, TypeVar

Value = bool | int | float | str | tuple[float, ...]
Condition = Mapping[str, tuple[str, ...]]
"""Values that other parameters must have, by name; all must hold."""

_SPEC = 'mvuav_parameter'
_Set = TypeVar('_Set', bound='ParameterSet')
_TYPE_NAMES = {bool: 'boolean', int: 'whole number', float: 'number', str: 'text', tuple: 'numbers'}


class ParameterError(ValueError):
    """A value that a parameter cannot take, with a reason that a person understands."""

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(f'{name}: {reason}')
        self.name = name
        self.reason = reason


@dataclass(frozen=True)
class ParameterSpec:
    """What one parameter may be."""

    name: str
    default: Value
    description: str
    unit: str = ''
    thesis: str = ''  # the thesis's name and value
    limits: tuple[float, float] | None = None  # the least and greatest value
    choices: tuple[str, ...] = ()
    odd: bool = False
    read_only: bool = False
    usual: tuple[float, float] | None = None  # the range that makes sense on most footage
    stage: str = ''  # of the processing
    counts: tuple[Condition, ...] = ()  # if any, one must hold for an effect
    booleans: tuple[str, str] | None = None  # the choices that false and true stand for as well
    is_file: bool = False  # names one, unless it is empty
    is_frame: bool = False  # names one of tf2, likewise

    @property
    def type(self) -> type[bool | int | float | str | tuple[float, ...]]:
        """The parameter's Python type, which is its default's; a tuple is of numbers."""
        return type(self.default)

    @property
    def constraint(self) -> str:
        """The values allowed, in words; empty where every value of the type is."""
        if self.choices:
            return 'one of ' + ', '.join(self.choices)
        words = 'odd' if self.odd else ''
        if self.limits is not None:
            words += f' {" to ".join(map(_plain, self.limits))}'
        return words.strip()

    def has_effect(self, values: Mapping[str, Any]) -> bool:
        """Whether it has one while the parameters of its set have these values."""
        return not self.counts or any(
            all(values.get(name) in wanted for name, wanted in condition.items())
            for condition in self.counts
        )

    def convert(self, value: object) -> Value:
        """Return ``value``, which may be NumPy's, as the parameter's type.

        A whole number is accepted for a float, and for a free text (``source:=0`` is a camera).

        Raises:
            ParameterError: the value has another type, or is out of range.
        """
        value = _of_python(value)
        if isinstance(self.default, tuple):
            return self._convert_tuple(value, len(self.default))
        if type(value) is int and (self.type is float or (self.type is str and not self.choices)):
            value = self.type(value)
        if self.booleans is not None and isinstance(value, bool):
            value = self.booleans[value]
        if type(value) is not self.type:
            given = _TYPE_NAMES.get(type(value), type(value).__name__)
            wanted = _TYPE_NAMES[self.type]
            raise ParameterError(self.name, f'takes a {wanted}, not the {given} {value!r:.200}')
        checked: Value = self._checked(value)
        return checked

    def _convert_tuple(self, value: object, length: int) -> tuple[float, ...]:
        is_list = isinstance(value, Sequence) and not isinstance(value, str)
        given: list[Any] = [*map(_of_python, value)] if is_list else []  # type: ignore[call-overload]
        if len(given) != length or any(type(number) not in (int, float) for number in given):
            shown = f'{given if is_list else value!r:.200}'
            if not is_list:
                shown += ' (ROS has them all alike: [0.0, 20.5, 0.0])'
            raise ParameterError(self.name, f'takes {length} numbers, not {shown}')
        return tuple(self._checked(float(number)) for number in given)

    def _checked(self, value: Any) -> Any:
        if isinstance(value, float) and not math.isfinite(value):
            raise ParameterError(self.name, f'must be a finite number, not {value}')
        if self.is_frame and value.startswith('/'):
            raise ParameterError(self.name, 'must not begin with a slash: tf2 takes no such frame')
        is_unknown = self.choices and value not in self.choices
        is_beyond = self.limits is not None and not self.limits[0] <= value <= self.limits[1]
        if is_unknown or is_beyond or (self.odd and value % 2 == 0):
            raise ParameterError(self.name, f'must be {self.constraint}, not {value!r:.200}')
        return value


def parameter(
    default: Any, description: str, limits: tuple[float, float] | None = None, **more: Any
) -> Any:
    """Declare a field of a `ParameterSet` by the fields of its `ParameterSpec`.

    The default also gives the type.
    """
    spec = {'default': default, 'description': description, 'limits': limits, **more}
    return field(default=default, metadata={_SPEC: spec})


@dataclass(frozen=True)
class ParameterSet:
    """Base of a node's parameters, which are all valid; fields are declared with `parameter`."""

    def __post_init__(self) -> None:
        for spec in self.specs():
            object.__setattr__(self, spec.name, spec.convert(getattr(self, spec.name)))
        self._check_together()

    def _check_together(self) -> None:
        """Raise `ParameterError` where values that are valid alone contradict each other."""

    @classmethod
    def specs(cls) -> tuple[ParameterSpec, ...]:
        """The parameters in order of declaration, those of a base that are by keyword last."""
        ordered = sorted(fields(cls), key=lambda field: bool(field.kw_only))
        return tuple(ParameterSpec(name=f.name, **f.metadata[_SPEC]) for f in ordered)

    @classmethod
    def spec(cls, name: str) -> ParameterSpec:
        """The parameter of that name; a `ParameterError` where there is none."""
        for spec in cls.specs():
            if spec.name == name:
                return spec
        near = get_close_matches(name, cls.names(), 1)
        hint = f'did you mean {near[0]}?' if near else f'there are {", ".join(cls.names())}'
        raise ParameterError(name, f'no such parameter; {hint}')

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """The parameters' names in order of declaration."""
        return tuple(spec.name for spec in cls.specs())

    @classmethod
    def from_mapping(cls: type[_Set], values: Mapping[str, object]) -> _Set:
        """The defaults, with some values replaced as by `changed`."""
        return cls().changed(values)

    @classmethod
    def given(cls: type[_Set], parameters: _Set | None) -> _Set:
        """What a program gives, or the defaults for None; a `TypeError` for anything else."""
        if parameters is not None and not isinstance(parameters, cls):
            kind = type(parameters).__name__
            raise TypeError(f'parameters must be {cls.__name__} (see load_parameters), not {kind}')
        return parameters or cls()

    def changed(self: _Set, values: Mapping[str, object]) -> _Set:
        """This set with some values replaced.

        Raises:
            ParameterError: a name is unknown or a value is not valid.
        """
        for name in values:
            self.spec(name)
        return replace(self, **values)

    def without_effect(self) -> dict[str, tuple[Condition, ...]]:
        """The names that are not at their defaults and have no effect now, and when they have."""
        values = self.as_dict()
        return {
            spec.name: spec.counts
            for spec in self.specs()
            if values[spec.name] != spec.default and not spec.has_effect(values)
        }

    def as_dict(self) -> dict[str, Value]:
        """Name to value, in order of declaration."""
        return {name: getattr(self, name) for name in self.names()}


def _of_python(value: Any) -> Any:
    """A number or an array of NumPy as Python's; what no float can hold as infinite."""
    value = value.tolist() if hasattr(value, 'tolist') else value
    if type(value) is int and abs(value) > sys.float_info.max:
        return math.inf if value > 0 else -math.inf
    return value


def _plain(number: float) -> str:
    return str(int(number)) if number == int(number) else str(number)


def write_description(spec: ParameterSpec) -> str:
    """The text of a parameter's descriptor."""
    said = {
        'Unit': spec.unit,
        'Default': default_text(spec.default),
        'Usual': f'{spec.usual[0]:g} to {spec.usual[1]:g}' if spec.usual else '',
        'Stage': spec.stage,
        'Counts with': '; or '.join(map(condition_text, spec.counts)),
        'Thesis': spec.thesis,
    }
    return ' '.join(
        [spec.description, *(f'{key}: {words}.' for key, words in said.items() if words)]
    )


def default_text(value: Value) -> str:
    """A default in words."""
    if isinstance(value, bool):
        return 'on' if value else 'off'
    if isinstance(value, float):
        return f'{value:.6g}'
    if isinstance(value, tuple):
        return ', '.join(map(default_text, value))
    return str(value) or '(empty)'


def condition_text(condition: Condition) -> str:
    """The values that other parameters must have, in words."""
    return ', '.join(f'{name} {" | ".join(values)}' for name, values in condition.items())

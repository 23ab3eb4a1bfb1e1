"""What a ROS parameter descriptor has no field for, as sentences at the end of its description.

``ros2 param describe`` shows them to people; the tuning panel reads them back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from mvuav_ros.parameters.declaration import Condition, ParameterSpec, Value

_KEYS = ('Unit', 'Default', 'Usual', 'Stage', 'Counts with', 'Thesis')
"""In the order in which they stand."""


@dataclass(frozen=True)
class DescriptorText:
    """A descriptor's description, taken apart, as in `ParameterSpec`; empty what it does not say.

    ``description`` is without the other sentences, ``default`` as a person writes it.
    """

    description: str
    unit: str = ''
    default: str = ''
    usual: tuple[float, float] | None = None
    stage: str = ''
    counts: tuple[Condition, ...] = ()
    thesis: str = ''


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
    return ' '.join([spec.description, *(f'{key}: {said[key]}.' for key in _KEYS if said[key])])


def read_description(text: str) -> DescriptorText:
    """Take a descriptor's text apart; of any node, in time linear in its length."""
    found: dict[str, str] = {}
    for key in reversed(_KEYS):
        head, mark, value = text.rpartition(f' {key}: ')
        if mark and value.endswith('.'):
            text, found[key] = head, value[:-1]
    return DescriptorText(
        text.strip(),
        unit=found.get('Unit', ''),
        default=found.get('Default', ''),
        usual=_range(found.get('Usual', '')),
        stage=found.get('Stage', ''),
        counts=_conditions(found.get('Counts with', '')),
        thesis=found.get('Thesis', ''),
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


def _conditions(text: str) -> tuple[Condition, ...]:
    alternatives = [each.split(', ') for each in text.split('; or ') if each]
    pairs = [[part.partition(' ') for part in parts] for parts in alternatives]
    return tuple({name: tuple(said.split(' | ')) for name, _, said in each} for each in pairs)


def _range(text: str) -> tuple[float, float] | None:
    try:
        low, high = map(float, text.split(' to '))
    except ValueError:
        return None
    return (low, high) if -math.inf < low < high < math.inf else None

"""Where a body carries its lights: the rig files, and the built-in tanker."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import yaml
from numpy.typing import NDArray

from mvuav_ros.parameters.yaml_text import Loader
from mvuav_ros.vision.frames import read_only

Point = tuple[float, float, float]
RigOrFile: TypeAlias = 'MarkerRig | str | Path'
_NUMBERS = (int, float, np.integer, np.floating)

SAME_PLACE = 1e-3  # Part of a rig's size within which two markers are in one place
LARGEST = 300.0  # m across: beyond it millimetres were written
MAX_NAMED = 12  # Lights that can be named at once: all threes of them are tried


class RigError(ValueError):
    """A rig file that cannot be used, with the reason."""


def _point(name: str, value: object) -> Point:
    if isinstance(value, (list, tuple, np.ndarray)) and len(value) == 3:
        numbers = [v for v in value if isinstance(v, _NUMBERS) and not isinstance(v, bool)]
        with suppress(OverflowError, ValueError):
            x, y, z = map(float, numbers)
            if math.isfinite(x + y + z):
                return x, y, z
    raise RigError(f'{name} must be [x, y, z] in metres, not {value!r}')


@dataclass(frozen=True)
class MarkerRig:
    """Named lights on a rigid body.

    Positions are metres in the body's frame, REP-103: x forward, y left, z up.

    Attributes:
        name: of the body; the airframe of ``tanker_747`` can be drawn.
        markers: name and position of every light, in the order of the results.
        dock: the point that a receiver steers for, from which the distance counts.
        boom: the pivot of the refuelling boom.

    Raises:
        RigError: a position is not three finite numbers, or two markers have one name.

    Examples:
        >>> from mvuav_ros import MarkerRig
        >>> drone = MarkerRig(
        ...     name='drone',
        ...     markers=(('left', (0, 0.4, 0)), ('right', (0, -0.4, 0)), ('top', (-0.1, 0, 0.3))),
        ...     dock=(0, 0, 0),
        ...     boom=(0, 0, 0),
        ... )
        >>> drone.names, drone.positions.shape
        (('left', 'right', 'top'), (3, 3))
    """

    name: str
    markers: tuple[tuple[str, Point], ...]
    dock: Point
    boom: Point

    def __post_init__(self) -> None:
        markers = tuple((str(name), _point(str(name), value)) for name, value in self.markers)
        object.__setattr__(self, 'markers', markers)
        object.__setattr__(self, 'dock', _point('dock', self.dock))
        object.__setattr__(self, 'boom', _point('boom', self.boom))
        if len(set(self.names)) < len(self.names) or not self.markers:
            raise RigError('a rig needs at least one marker, and a name of its own for each')

    @staticmethod
    def given(rig: RigOrFile) -> MarkerRig:
        """What a program gives: a rig, or its file (see `load_rig`); a `TypeError` for others."""
        if isinstance(rig, (str, Path)):
            return load_rig(rig)
        if not isinstance(rig, MarkerRig):
            raise TypeError(f'rig must be a MarkerRig or its file, not {type(rig).__name__}')
        return rig

    @property
    def names(self) -> tuple[str, ...]:
        """The lights' names."""
        return tuple(name for name, _ in self.markers)

    @cached_property
    def positions(self) -> NDArray[np.float64]:
        """(n, 3), m."""
        return read_only(np.array([position for _, position in self.markers]))

    def moved(self, positions: NDArray[np.float64]) -> MarkerRig:
        """The rig with its lights at other positions, (n, 3), m."""
        return replace(self, markers=tuple(zip(self.names, positions.tolist(), strict=True)))

    @cached_property
    def middle(self) -> NDArray[np.float64]:
        """(3,), m, the mean of the positions."""
        return read_only(np.asarray(self.positions.mean(axis=0)))

    def distance(self, rotation: NDArray[np.float64], translation: NDArray[np.float64]) -> float:
        """From the camera that sees it so (m) to its origin, or its middle where that is farther.

        Errors of a pose are measured by it: a camera may come to the origin, but not to the lights.
        """
        middle = rotation.dot(self.middle) + translation
        return max(math.hypot(*translation.tolist()), math.hypot(*middle.tolist()))

    @cached_property
    def size(self) -> float:
        """The greatest distance of two lights, m."""
        return max(math.dist(a, b) for _, a in self.markers for _, b in self.markers)

    @property
    def reach(self) -> float:
        """The greatest distance of a light from the x axis, m."""
        return max(math.hypot(y, z) for _, (_, y, z) in self.markers)


TANKER_747 = MarkerRig(
    name='tanker_747',
    markers=(
        ('left_wing', (-12.0, 29.8, 1.0)),
        ('left_stabilizer', (-37.0, 11.0, 3.0)),
        ('rudder', (-36.5, 0.0, 13.0)),
        ('right_stabilizer', (-37.0, -11.0, 3.0)),
        ('right_wing', (-12.0, -29.8, 1.0)),
    ),
    dock=(-37.0, 0.0, 3.0),
    boom=(-34.0, 0.0, -2.4),
)
"""``config/tanker_747.yaml``, for where no share folder is installed."""


_KEYS = ('name', 'markers', 'dock', 'boom', 'standard_deviations')
"""Of a rig file; the last one is what `mvuav rig calibrate` says of its result."""


class _Loader(Loader):
    """Takes a name as it is written, where YAML has True for ``yes`` and 8 for ``010``.

    A key that stands twice is refused: YAML would quietly keep the last.
    """

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value != '<<':
                key.tag = 'tag:yaml.org,2002:str'
        keys = [self.construct_object(key, deep=True) for key, _ in node.value]
        twice = sorted({str(key) for key in keys if keys.count(key) > 1})
        if twice:
            raise RigError(f'{", ".join(twice)} is listed twice')
        return super().construct_mapping(node, deep)


def load_rig(path: str | Path) -> MarkerRig:
    """Read a rig file (see ``config/tanker_747.yaml``).

    It is YAML, in which ``markers`` maps names to [x, y, z] in m, x forward, y left, z up.

    Raises:
        RigError: there is no such file, or it says something else than a rig.

    Examples:
        >>> from mvuav_ros import load_rig
        >>> load_rig('config/tanker_747.yaml').names[:2]
        ('left_wing', 'left_stabilizer')
    """
    try:
        content = _Loader(Path(path).expanduser().read_text(encoding='utf-8')).get_single_data()
        return parse_rig(content, Path(path).stem)
    except OSError as error:
        raise RigError(f'{path}: {error.strerror}') from error
    except RigError as error:
        raise RigError(f'{path}: {error}') from error
    except Exception as error:
        # Beside YAMLError whatever its constructors stumble over, such as a date of month 13.
        reason = ' '.join(str(error).split())
        raise RigError(f'{path} is not YAML: {reason}') from error


def parse_rig(content: object, name: str = 'body') -> MarkerRig:
    """The rig in a YAML file's content; ``name`` is for a file that gives none.

    Raises:
        RigError: something is missing, unknown, or not a position.
    """
    if not isinstance(content, Mapping):
        raise RigError('the file must be a mapping with the key "markers"')
    unknown = sorted(str(key) for key in set(content) - set(_KEYS))
    if unknown:
        raise RigError(f'unknown key {", ".join(unknown)}; known are {", ".join(_KEYS)}')
    markers = content.get('markers')
    if not isinstance(markers, Mapping) or not markers:
        raise RigError('"markers" must map at least one name to [x, y, z] in metres')
    lights = tuple((str(key), _point(str(key), value)) for key, value in markers.items())
    dock = content.get('dock', np.mean([position for _, position in lights], axis=0))
    given = '' if content.get('name') is None else str(content['name'])
    rig = MarkerRig(given or name, lights, dock, content.get('boom', dock))
    if twins := same_place(rig):
        raise RigError(twins)
    if rig.size > LARGEST:
        raise RigError(f'{rig.size:.4g} m across cannot be: positions are in metres')
    if rig.reach == 0.0:
        raise RigError('all markers lie on the x axis, so roll cannot be measured')
    return rig


def same_place(rig: MarkerRig) -> str:
    """Which two lights of a rig are in one place, in words; empty where each has its own."""
    for (one, first), (other, second) in combinations(rig.markers, 2):
        if math.dist(first, second) <= SAME_PLACE * rig.size:
            return f'{one} and {other} are at the same position'
    return ''


def rig_text(rig: MarkerRig, deviations: NDArray[np.float64]) -> str:
    """A rig file with the standard deviations (n, 3), m, of its markers' positions."""

    def listed(name: str, values: Any, digits: int) -> str:
        numbers = ', '.join(f'{value:.{digits}f}' for value in values)
        return f'{json.dumps(name)}: [{numbers}]'

    lines = [f'name: {json.dumps(rig.name)}', 'markers:  # m']
    lines += [f'  {listed(name, position, 5)}' for name, position in rig.markers]
    lines += [listed('dock', rig.dock, 5), listed('boom', rig.boom, 5)]
    lines += ['standard_deviations:  # of the markers, m']
    pairs = zip(rig.names, deviations, strict=True)
    lines += [f'  {listed(name, deviation, 6)}' for name, deviation in pairs]
    return '\n'.join(lines) + '\n'

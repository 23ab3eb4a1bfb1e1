"""Named sets of parameters: ordinary ROS 2 parameter files in one folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import yaml

from mvuav_ros.panel import foreign
from mvuav_ros.panel.names import NameRefusedError, checked_name
from mvuav_ros.parameters.declaration import ParameterError, Value
from mvuav_ros.parameters.parameter_file import read_parameter_values
from mvuav_ros.processing.registry import PROCESSORS

LARGEST_SET = 100_000
"""Bytes."""
_SUFFIX = '.yaml'
_DEEPEST = 20
_OPENING = (
    yaml.BlockMappingStartToken,
    yaml.BlockSequenceStartToken,
    yaml.FlowMappingStartToken,
    yaml.FlowSequenceStartToken,
)
_CLOSING = (yaml.BlockEndToken, yaml.FlowMappingEndToken, yaml.FlowSequenceEndToken)
_BUILT_IN = ('default', 'thesis')


@dataclass(frozen=True)
class Difference:
    """A parameter with its values in two sets; None where a set has none."""

    name: str
    left: object
    right: object

    @property
    def differs(self) -> bool:
        """Whether both have a value and not the same one."""
        return self.left is not None and self.right is not None and self.left != self.right


class SetStore:
    """The sets of a folder, and those shipped with the package, which cannot be overwritten."""

    def __init__(self, folder: Path, built_in: Path | None = None) -> None:
        """Look after a folder.

        Args:
            folder: of the user's sets; made when the first one is saved.
            built_in: the folder with ``default.yaml`` and ``thesis.yaml``.
        """
        self.folder = folder
        self._built_in = {
            name: built_in / f'{name}{_SUFFIX}'
            for name in _BUILT_IN
            if built_in is not None and (built_in / f'{name}{_SUFFIX}').is_file()
        }

    def names(self, kind: str) -> list[str]:
        """The sets that say something of a kind of node; the shipped ones first."""
        own = sorted(
            path.stem
            for path in self.folder.glob(f'*{_SUFFIX}')
            if path.stem not in self._built_in and _is_name(path.stem)
        )
        return [name for name in (*self._built_in, *own) if self._says(name, kind)]

    def is_built_in(self, name: str) -> bool:
        """Whether a set is shipped with the package."""
        return name in self._built_in

    def load(self, name: str, kind: str) -> dict[str, Value]:
        """The values of a set for a kind of node; lists of anything but numbers are left out.

        Raises:
            NameRefusedError: no set can have this name.
            ParameterError: the file cannot be read.
        """
        path = self._path(name)
        _check_content(path)
        values = read_parameter_values(path, kind)
        known = {name: foreign.plain_value(value) for name, value in values.items()}
        return {name: value for name, value in known.items() if value is not None}

    def content(self, name: str) -> bytes:
        """The file of a set.

        Raises:
            NameRefusedError: no set can have this name.
            OSError: it cannot be read.
        """
        return self._path(name).read_bytes()

    def add(self, name: str, content: bytes) -> list[str]:
        """Take in a file from elsewhere; one that is no parameter file is not kept.

        Returns:
            The kinds of nodes that it says something of.

        Raises:
            NameRefusedError: the name cannot be given, or is a set's already.
            ParameterError: it is no parameter file, or not one of our nodes.
            OSError: the file cannot be written.
        """
        path = self._path(name)
        if path.exists():
            raise NameRefusedError(f'there is a set {name} already')
        self.folder.mkdir(parents=True, exist_ok=True)
        new = path.with_suffix('.new')
        try:
            new.write_bytes(content)
            _check_content(new)
            kinds = [kind for kind in PROCESSORS if read_parameter_values(new, kind)]
            if not kinds:
                raise ParameterError(name, f'has no values of {" or ".join(PROCESSORS)}')
            new.rename(path)
        finally:
            new.unlink(missing_ok=True)
        return kinds

    def save(self, name: str, kind: str, values: Mapping[str, Value]) -> Path:
        """Write a set, in place of one of the same name.

        Raises:
            NameRefusedError: the name cannot be given, or is a shipped set's.
            OSError: the file cannot be written.
        """
        if name.strip() in self._built_in:
            raise NameRefusedError(f'{name.strip()} is part of the package; choose another name')
        path = self._path(name)
        self.folder.mkdir(parents=True, exist_ok=True)
        content = {f'/**/{kind}': {'ros__parameters': dict(values)}}
        whole = path.with_suffix('.new')
        whole.write_text(yaml.safe_dump(content, sort_keys=False, allow_unicode=True))
        whole.replace(path)
        return path

    def delete(self, name: str) -> None:
        """Remove one of the user's sets.

        Raises:
            NameRefusedError: it is a shipped one, or the name cannot be.
        """
        if name in self._built_in:
            raise NameRefusedError(f'{name} is part of the package and cannot be deleted')
        self._path(name).unlink(missing_ok=True)

    def _path(self, name: str) -> Path:
        if name in self._built_in:
            return self._built_in[name]
        return self.folder / f'{checked_name(name)}{_SUFFIX}'

    def _says(self, name: str, kind: str) -> bool:
        try:
            return bool(self.load(name, kind))
        except ValueError:
            return False


def _check_content(path: Path) -> None:
    """Refuse what would make YAML's reader take all memory or stack."""
    try:
        if path.stat().st_size > LARGEST_SET:
            raise ParameterError(path.stem, f'has more than {LARGEST_SET} bytes')
        depth = 0
        for token in yaml.scan(path.read_text()):
            depth += isinstance(token, _OPENING) - isinstance(token, _CLOSING)
            if depth > _DEEPEST or isinstance(token, yaml.AliasToken):
                raise ParameterError(
                    path.stem, 'is not a parameter file: nested too deeply, or with aliases'
                )
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ParameterError(path.stem, f'cannot be read: {foreign.words(error)}') from None


def differences(
    left: Mapping[str, object], right: Mapping[str, object], *, all_of_them: bool = False
) -> list[Difference]:
    """What two sets say of each parameter, in the order of the first.

    Args:
        left: name to value.
        right: the same.
        all_of_them: also those that are equal or that only one set has.
    """
    names = dict.fromkeys((*left, *right))
    found = [Difference(name, left.get(name), right.get(name)) for name in names]
    return found if all_of_them else [each for each in found if each.differs]


def _is_name(text: str) -> bool:
    try:
        return checked_name(text) == text
    except NameRefusedError:
        return False

"""Named sets of parameters: ordinary ROS 2 parameter files in one folder."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import yaml

from mvuav_ros.panel import sanitized
from mvuav_ros.panel.sanitized import NameRefusedError, checked_name
from mvuav_ros.parameters.declaration import ParameterError, Value
from mvuav_ros.parameters.parameter_file import NODE_PARAMETERS, parameter_values
from mvuav_ros.processing.registry import PROCESSORS

MAX_SET_BYTES = 100_000
"""Bytes."""
_SUFFIX = '.yaml'
_MAX_DEPTH = 20
_BUILT_IN = ('default', 'thesis')


class SetStore:
    """The sets of a folder, and those shipped with the package, which cannot be overwritten.

    All methods with a name raise NameRefusedError where no set can have it, or may not have it;
    those that read a file ParameterError where it is none of ours, and all of them OSError.
    ``built_in`` are the files of the shipped ones.
    ``rejected`` are the files that the last call of `names` could not use, with the reasons.
    """

    def __init__(self, folder: Path, built_in: Path | None = None) -> None:
        """Look after a folder, made when the first set is saved; ``built_in`` has the shipped."""
        self.folder, self.rejected = folder, dict[str, str]()
        shipped = [built_in / f'{name}{_SUFFIX}' for name in _BUILT_IN] if built_in else []
        self.built_in = {path.stem: path for path in shipped if path.is_file()}

    def names(self, kind: str) -> list[str]:
        """The sets that say something of a kind of node; the shipped ones first."""
        own = sorted({path.stem for path in self.folder.glob(f'*{_SUFFIX}')} - {*self.built_in})
        found, self.rejected = [], {}
        for name in (*self.built_in, *own):
            try:
                if self.load(name, kind) and self._path(name).stem == name:
                    found.append(name)
            except (ParameterError, NameRefusedError) as error:
                self.rejected[sanitized.words(name)] = sanitized.words(error)
        return found

    def load(self, name: str, kind: str) -> dict[str, Value]:
        """The values of a set for a kind of node; lists of anything but numbers are left out."""
        values = _values(self._path(name), kind)
        known = {name: sanitized.plain_value(value) for name, value in values.items()}
        return {name: value for name, value in known.items() if value is not None}

    def content(self, name: str) -> bytes:
        """The file of a set."""
        return sanitized.file_text(self._path(name), MAX_SET_BYTES).encode()

    def add(self, name: str, content: bytes) -> list[str]:
        """Take in a parameter file; returns the kinds of nodes that it says something of."""
        path = self._path(name)
        if path.exists():
            raise NameRefusedError(f'there is a set {name} already')
        new = self._new(path)
        try:
            new.write_bytes(content)
            kinds = [kind for kind in PROCESSORS if _values(new, kind)]
            if not kinds:
                raise ParameterError(name, f'has no values of {" or ".join(PROCESSORS)}')
            new.rename(path)
        finally:
            new.unlink(missing_ok=True)
        return kinds

    def save(self, name: str, kind: str, values: Mapping[str, Value]) -> Path:
        """Write a set, in place of one of the same name for this kind of node."""
        if name.strip() in self.built_in:
            raise NameRefusedError(f'{name.strip()} is part of the package; choose another name')
        path = self._path(name)
        given: dict[str, Mapping[str, object]] = {}
        for other in NODE_PARAMETERS:
            with suppress(ParameterError):
                given[other] = _values(path, other)
        given[kind] = dict(values)
        content = {f'/**/{n}': {'ros__parameters': each} for n, each in given.items() if each}
        new = self._new(path)
        new.write_text(yaml.safe_dump(content, sort_keys=False, allow_unicode=True))
        return new.replace(path)

    def delete(self, name: str) -> None:
        """Remove one of the user's sets."""
        if name in self.built_in:
            raise NameRefusedError(f'{name} is part of the package and cannot be deleted')
        self._path(name).unlink(missing_ok=True)

    def _path(self, name: str) -> Path:
        return self.built_in.get(name) or self.folder / f'{checked_name(name)}{_SUFFIX}'

    def _new(self, path: Path) -> Path:
        """Where a file is written before it takes its place as a whole."""
        self.folder.mkdir(parents=True, exist_ok=True)
        new = path.with_suffix('.new')
        # It may be anything that somebody has put there, such as a FIFO.
        new.unlink(missing_ok=True)
        return new


def _values(path: Path, kind: str) -> dict[str, object]:
    """Of a file for a kind of node; what takes YAML's reader all memory or stack is refused."""
    try:
        text, depth = sanitized.file_text(path, MAX_SET_BYTES), 0
        for event in yaml.parse(text, yaml.SafeLoader):
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > _MAX_DEPTH or isinstance(event, yaml.AliasEvent):
                raise ParameterError(
                    path.stem, 'is not a parameter file: nested too deeply, or with aliases'
                )
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ParameterError(path.stem, f'cannot be read: {sanitized.words(error)}') from None
    return parameter_values(text, path.stem, kind)


def differences(
    left: Mapping[str, object], right: Mapping[str, object]
) -> dict[str, tuple[object, object]]:
    """The parameters that two sets have with different values, in the order of the first."""
    both = {name: (left[name], right[name]) for name in left if name in right}
    return {name: values for name, values in both.items() if values[0] != values[1]}

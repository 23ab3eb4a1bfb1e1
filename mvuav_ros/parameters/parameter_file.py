"""Ordinary ROS 2 parameter files, and ``node:name:=value`` on the command line."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import yaml

from mvuav_ros.parameters.declaration import ParameterError


def read_parameter_values(path: Path, node: str) -> dict[str, object]:
    """The values that a parameter file has for a node.

    Keys name nodes with or without slash, in namespaces or with wildcards (``/**``, ``/*``);
    later entries win, as in rcl. ``node`` is without slash.

    Raises:
        ParameterError: the file cannot be read or is not a parameter file.
    """
    values: dict[str, object] = {}
    for key, sections in _flattened_nodes(_read(path)):
        if not isinstance(sections, dict) or not isinstance(sections.get('ros__parameters'), dict):
            raise ParameterError(str(path), f'{key} has no ros__parameters')
        # In any namespace.
        if fnmatchcase(node, key.rsplit('/', 1)[-1].replace('**', '*')):
            values.update(_flattened(sections['ros__parameters']))
    return values


def node_keys(path: Path) -> list[str]:
    """The names and patterns of the nodes that a parameter file has values for.

    Raises:
        ParameterError: the file cannot be read or is not a parameter file.
    """
    return [key for key, _ in _flattened_nodes(_read(path))]


def fits(key: str, node: str) -> bool:
    """Whether rcl takes values under a key for a node of that full name."""
    pattern = re.escape(key if key.startswith('/') else f'/{key}')
    pattern = pattern.replace(r'/\*\*', r'(/[^/]+)*').replace(r'\*', '[^/]+')
    return re.fullmatch(pattern, node) is not None


def _read(path: Path) -> dict[Any, Any]:
    try:
        content = yaml.safe_load(path.read_text())
    except OSError as error:
        raise ParameterError(str(path), error.strerror or str(error)) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        problem = ' '.join(str(error).split())
        raise ParameterError(str(path), f'is not YAML: {problem}') from error
    if not isinstance(content, dict):
        raise ParameterError(str(path), 'is not a ROS 2 parameter file')
    return content


def is_every_nodes(name: str) -> bool:
    """Whether it is a parameter that every ROS node has, as ``ros2 param dump`` writes them."""
    return name in ('use_sim_time', 'start_type_description_service') or name.startswith(
        'qos_overrides.'
    )


def parse_assignment(text: str) -> tuple[str, str, object]:
    """Node, name and value of ``node:name:=value``; the value is read as YAML, as ROS does.

    Raises:
        ParameterError: the text has another form.
    """
    target, sign, value = text.partition(':=')
    node, colon, name = target.partition(':')
    if not (sign and colon and node and name):
        raise ParameterError(text, 'write node:name:=value, as in marker_tracker:threshold:=0.6')
    try:
        return node.strip('/'), name, yaml.safe_load(value)
    except yaml.YAMLError as error:
        raise ParameterError(text, f'the value {value!r} is not YAML') from error


def _flattened_nodes(content: Mapping[Any, Any]) -> Iterable[tuple[str, Any]]:
    """Node keys, namespaces written as an outer level joined to them."""
    for key, value in content.items():
        if isinstance(value, dict) and 'ros__parameters' not in value and value:
            for inner, section in _flattened_nodes(value):
                yield f'{key}/{inner.lstrip("/")}', section
        else:
            yield str(key), value


def _flattened(values: Mapping[Any, Any], prefix: str = '') -> dict[str, object]:
    flat: dict[str, object] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            flat.update(_flattened(value, f'{prefix}{name}.'))
        else:
            flat[f'{prefix}{name}'] = value
    return flat

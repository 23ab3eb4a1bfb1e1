"""Ordinary ROS 2 parameter files, ``node:name:=value``, and the nodes' parameters from both."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from mvuav_ros.detectors import DETECTORS, load_class
from mvuav_ros.parameters.declaration import ParameterError, ParameterSet, Value
from mvuav_ros.parameters.video_source import VideoSourceParameters
from mvuav_ros.parameters.yaml_text import read_yaml


def parameter_values(text: str, name: str, node: str) -> dict[str, object]:
    """The values that a parameter file has for a node; ``name`` is what errors call the file.

    Keys name nodes with or without slash, in namespaces or with wildcards (``/**``, ``/*``);
    later entries win, as in rcl. Under a wildcard there may be parameters of this package's other
    nodes, which are left out. ``node`` is one of this package, without slash.

    Raises:
        ParameterError: the text is not a parameter file, or has several such nodes that differ.
    """
    return _values_of(node, _sections(text, name), name)


def _values_of(
    node: str, sections: Iterable[_Section], file: str, image_topic: str | None = None
) -> dict[str, object]:
    """The node's, in whichever namespace; of several that differ, that of the image topic's.

    Where none is in that namespace, one of the node in any (``/**/marker_tracker``) comes first.
    """
    every = {name for kind in NODE_PARAMETERS.values() for name in kind.names()}
    others = every.difference(NODE_PARAMETERS[node].names())
    ours = [(f'/{key.strip("/")}', section) for key, section in sections if names_node(key, node)]
    names = [*dict.fromkeys(key for key, _ in ours if '*' not in key)] or ['']
    if image_topic:
        topic = f'/{image_topic.lstrip("/")}'
        inside = [name for name in names if topic.startswith(name.removesuffix(node))]
        own = f'{topic.rpartition("/")[0]}/{node}'
        is_wild = any(fits(key, own) and '*' not in key.rsplit('/', 1)[-1] for key, _ in ours)
        names = sorted(inside, key=len)[-1:] or ([own] if is_wild else names)
    found: list[dict[str, object]] = [{} for _ in names]
    for name, values in zip(names, found, strict=True):
        for key, section in ours:
            if not name or fits(key, name):
                given = dict(_leaves(section, '.'))
                left_out = others if '*' in key.rsplit('/', 1)[-1] else ()
                values.update({each: given[each] for each in given if each not in left_out})
    if any(values != found[0] for values in found):
        said = f'{" and ".join(names)} differ; choose one by --image-topic, or by another file'
        raise ParameterError(file, said)
    return found[0]


def names_node(key: str, node: str) -> bool:
    """Whether a key of a parameter file is for a node, in any namespace."""
    return fnmatchcase(node, key.rsplit('/', 1)[-1].replace('**', '*'))


def read_node_keys(path: Path) -> list[str]:
    """The nodes that a file speaks of, as it names them; a `ParameterError` where it is none."""
    return [key for key, _ in _sections(_text(path), str(path))]


def fits(key: str, node: str) -> bool:
    """Whether rcl takes values under a key for a node of that full name."""
    pattern = re.escape(key if key.startswith('/') else f'/{key}')
    pattern = pattern.replace(r'/\*\*', r'(/[^/]+)*').replace(r'\*', '[^/]+')
    return re.fullmatch(pattern, node) is not None


def _text(path: Path) -> str:
    try:
        return path.read_text()
    except OSError as error:
        raise ParameterError(str(path), error.strerror or str(error)) from error
    except UnicodeDecodeError as error:
        raise ParameterError(str(path), f'is not YAML: {error}') from error


_Section = tuple[str, Mapping[Any, Any]]
"""The key of a node, and its values."""


def _sections(text: str, name: str) -> Iterator[_Section]:
    try:
        content = read_yaml(text)
    except Exception as error:
        # Beside YAMLError whatever its constructors stumble over: ``!!int ""`` is an IndexError.
        problem = ' '.join(str(error).split())
        raise ParameterError(name, f'is not YAML: {problem}') from error
    if not isinstance(content, dict):
        raise ParameterError(name, 'is not a ROS 2 parameter file')
    # A namespace may be an outer level.
    for key, sections in _leaves(content, '/', lambda node: not node or 'ros__parameters' in node):
        if not isinstance(sections, dict) or not isinstance(sections.get('ros__parameters'), dict):
            raise ParameterError(name, f'{key} has no ros__parameters')
        yield key, sections['ros__parameters']


def is_every_nodes(name: str) -> bool:
    """Whether it is a parameter that every ROS node has, as ``ros2 param dump`` writes them."""
    return name in ('use_sim_time', 'start_type_description_service') or name.startswith(
        'qos_overrides.'
    )


def parse_assignment(text: str) -> tuple[str, str, object]:
    """Node, name and value, read as YAML, of ``node:name:=value``; else a `ParameterError`."""
    target, sign, value = text.partition(':=')
    node, colon, name = target.partition(':')
    if not (sign and colon and node and name):
        raise ParameterError(text, 'write node:name:=value, as in marker_tracker:threshold:=0.6')
    try:
        return node.strip('/'), name, read_yaml(value)
    except Exception as error:
        raise ParameterError(text, f'the value {value!r} is not YAML') from error


def _leaves(
    tree: Mapping[Any, Any], sign: str, is_leaf: Callable[[Any], bool] = lambda value: False
) -> Iterator[tuple[str, Any]]:
    """What a tree of mappings holds, by the keys on the way there, joined by a sign."""
    for key, value in tree.items():
        if isinstance(value, dict) and not is_leaf(value):
            for inner, leaf in _leaves(value, sign, is_leaf):
                yield f'{key}{sign}{inner.lstrip(sign)}', leaf
        else:
            yield str(key), value


NODE_PARAMETERS: dict[str, type[ParameterSet]] = {
    'video_source': VideoSourceParameters,
    **{name: load_class(detector.parameters) for name, detector in DETECTORS.items()},
}


NodeParameters = dict[str, dict[str, Value]]
"""What differs from the defaults, by node and parameter."""


def node_names(text: str | None, otherwise: Iterable[str] = DETECTORS) -> list[str]:
    """The nodes that a user names, separated by commas; ``otherwise`` if the option is left out.

    Raises:
        ParameterError: there is no such node, or none is named.
    """
    if text is None:
        return list(otherwise)
    names = list(dict.fromkeys(name.strip() for name in text.split(',') if name.strip()))
    unknown = [name for name in names if name not in DETECTORS]
    if unknown or not names:
        raise ParameterError(
            '--nodes', f'{", ".join(unknown) or "empty"}; there are {", ".join(DETECTORS)}'
        )
    return names


def resolve_parameters(
    nodes: Iterable[str],
    files: Iterable[Path] = (),
    assignments: Iterable[str] = (),
    image_topic: str | None = None,
) -> NodeParameters:
    """The values that ROS 2 parameter files, then ``node:name:=value``, give to nodes.

    Of several files later ones win as in rcl: a key's values take the place of those that it had,
    and the keys hold in the order in which they first occur. Where there is a node in several
    namespaces, the one that the ``image_topic`` is in counts; it is an error if that does not say
    which, and they differ.

    Raises:
        ParameterError: a parameter is unknown, its value not valid, its node not among ``nodes``,
            or a file none of parameters. So it is if a file names none of this package's nodes,
            or one that is spelt nearly like them; those of other nodes are not looked at.
    """
    files = list(files)
    merged: dict[str, dict[str, Any]] = {}
    for path in files:
        sections = [*_sections(_text(path), str(path))]
        _check_node_keys(path, [key for key, _ in sections])
        for key, section in sections:
            merged.setdefault(f'/{key.strip("/")}', {}).update(_leaves(section, '.'))
    named = ', '.join(map(str, files))
    given = {node: _values_of(node, merged.items(), named, image_topic) for node in nodes}
    for node, name, value in map(parse_assignment, assignments):
        if node not in given:
            raise ParameterError(f'{node}:{name}', f'{node} is not among {", ".join(nodes)}')
        given[node][name] = value
    resolved = {}
    for node, values in given.items():
        own = {name: value for name, value in values.items() if not is_every_nodes(name)}
        known = NODE_PARAMETERS[node].from_mapping(own)
        resolved[node] = {name: getattr(known, name) for name in own}
    return resolved


def _check_node_keys(path: Path, keys: Sequence[str]) -> None:
    others = [key for key in keys if not any(names_node(key, node) for node in NODE_PARAMETERS)]
    for key in others:
        # A whole robot's file names its other nodes as well. From 0.55 on "runway" is one of ours
        # misspelt, "camera_driver" is not.
        node = key.rsplit('/', 1)[-1]
        alike = '*' in node or difflib.get_close_matches(node, NODE_PARAMETERS, cutoff=0.55)
        if alike or len(others) == len(keys):
            raise ParameterError(
                str(path), f'no such node: {key}; there are {", ".join(NODE_PARAMETERS)}'
            )


def complete(parameters: Mapping[str, Mapping[str, Any]]) -> NodeParameters:
    """Every parameter of the nodes, the defaults included."""
    return {
        node: NODE_PARAMETERS[node].from_mapping(values).as_dict()
        for node, values in parameters.items()
    }


def load_parameters(path: str | Path, node: str) -> ParameterSet:
    """A node's parameters from a ROS 2 parameter file; what the file leaves out is the default.

    Args:
        path: YAML file, as ``ros2 param dump`` writes it.
        node: ``marker_tracker``, ``runway_detector`` or ``video_source``.

    Returns:
        `MarkerTrackerParameters`, `RunwayDetectorParameters` or `VideoSourceParameters`.

    Raises:
        ParameterError: no such node, the file cannot be read or has none of this package's nodes,
            or it holds a misspelt node, an unknown parameter or a value that the parameter cannot
            take.

    Examples:
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> from mvuav_ros import load_parameters
        >>> with TemporaryDirectory() as folder:
        ...     file = Path(folder, 'mine.yaml')
        ...     _ = file.write_text('marker_tracker: {ros__parameters: {threshold: 0.6}}')
        ...     load_parameters(file, 'marker_tracker').threshold
        0.6
    """
    if node not in NODE_PARAMETERS:
        raise ParameterError(node, f'no such node; there are {", ".join(NODE_PARAMETERS)}')
    return NODE_PARAMETERS[node].from_mapping(resolve_parameters([node], [Path(path)])[node])

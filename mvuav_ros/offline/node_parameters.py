"""From ``--nodes``, a ``--params-file`` and ``--param`` to each node's parameters."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from mvuav_ros.detectors import DETECTORS
from mvuav_ros.parameters.declaration import ParameterError, Value
from mvuav_ros.parameters.parameter_file import (
    NODE_PARAMETERS,
    is_every_nodes,
    parse_assignment,
    read_parameter_values,
    refuse_unknown_nodes,
)

PROCESSING_NODES = tuple(DETECTORS)
NodeParameters = dict[str, dict[str, Value]]
"""What differs from the defaults, by node and parameter."""


def node_names(text: str | None, otherwise: Sequence[str] = PROCESSING_NODES) -> list[str]:
    """The nodes that a user names, separated by commas; ``otherwise`` if the option is left out.

    Raises:
        ParameterError: there is no such node, or none is named.
    """
    if text is None:
        return list(otherwise)
    names = list(dict.fromkeys(name.strip() for name in text.split(',') if name.strip()))
    unknown = [name for name in names if name not in PROCESSING_NODES]
    if unknown or not names:
        raise ParameterError(
            '--nodes', f'{", ".join(unknown) or "empty"}; there are {", ".join(PROCESSING_NODES)}'
        )
    return names


def resolve_parameters(
    nodes: Sequence[str], path: Path | None = None, assignments: Iterable[str] = ()
) -> NodeParameters:
    """The values that a ROS 2 parameter file, then ``node:name:=value``, give to nodes.

    Raises:
        ParameterError: a parameter is unknown, its value not valid, its node not among ``nodes``,
            or the file none of parameters, or one of other nodes.
    """
    if path:
        refuse_unknown_nodes(path)
    given: dict[str, dict[str, object]] = {
        node: read_parameter_values(path, node) if path else {} for node in nodes
    }
    for node, name, value in map(parse_assignment, assignments):
        if node not in given:
            raise ParameterError(f'{node}:{name}', f'{node} is not among {", ".join(nodes)}')
        given[node][name] = value
    return {node: _valid(node, values) for node, values in given.items()}


def complete(parameters: NodeParameters) -> NodeParameters:
    """Every parameter of the nodes, the defaults included."""
    return {
        node: NODE_PARAMETERS[node].from_mapping(values).as_dict()
        for node, values in parameters.items()
    }


def _valid(node: str, values: dict[str, object]) -> dict[str, Value]:
    own = {name: value for name, value in values.items() if not is_every_nodes(name)}
    known = NODE_PARAMETERS[node].from_mapping(own).as_dict()
    return {name: known[name] for name in own}

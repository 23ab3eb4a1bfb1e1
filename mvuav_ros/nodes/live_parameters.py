"""A node's ROS parameters from its frozen dataclass."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from difflib import get_close_matches
from itertools import pairwise
from pathlib import Path
from typing import Any, Generic, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_service import ParameterService
from rclpy.qos import QoSPolicyKind, QoSProfile
from rclpy.qos_overriding_options import QosCallbackResult, QoSOverridingOptions

from mvuav_ros.parameters.declaration import (
    ParameterError,
    ParameterSet,
    ParameterSpec,
    Value,
    write_description,
)
from mvuav_ros.parameters.parameter_file import NODE_PARAMETERS, fits, read_node_keys

P = TypeVar('P', bound=ParameterSet)


def _check_qos(qos: QoSProfile) -> QosCallbackResult:
    """Whether a topic can have the QoS that a user gave."""
    result = QosCallbackResult(successful=qos.depth >= 0)
    result.reason = f'depth must be 0 or more, not {qos.depth}'
    return result


OVERRIDABLE = QoSOverridingOptions(
    [
        QoSPolicyKind.HISTORY,
        QoSPolicyKind.DEPTH,
        QoSPolicyKind.RELIABILITY,
        QoSPolicyKind.DURABILITY,
    ],
    callback=_check_qos,
)
"""What users may set of a topic: ``qos_overrides.TOPIC.subscription.reliability``."""
_AT_THE_START = ('autostart', 'qos_overrides.', 'start_type_description_service')
_UNTIL_CONFIGURED = ' and while the node is unconfigured (ros2 lifecycle set … cleanup)'


class _SetInAnyOrder(ParameterService):
    """Answers ``set_parameters`` whatever the order of the values; all at once by the same checks.

    rclpy sets them one by one. ``ros2 param load`` of other rows would fail half-way where the new
    end lies before the old start, so rejected values are tried again once others are accepted. A
    value that is set already is no change, even of a read-only parameter: a dump holds dozens of
    those (``qos_overrides``), and a file may write them in another way (``fps: 30``).
    """

    def __init__(self, node: Node, convert: Callable[[Parameter], Parameter]) -> None:
        super().__init__(node)
        self._convert = convert

    def _set_parameters_atomically_callback(
        self,
        request: SetParametersAtomically.Request,
        response: SetParametersAtomically.Response,
    ) -> SetParametersAtomically.Response:
        wanted, refused = self._changes(request.parameters)
        if refused:
            response.result = next(iter(refused.values()))
            return response
        again = SetParametersAtomically.Request(parameters=[*wanted.values()])
        return super()._set_parameters_atomically_callback(again, response)

    def _changes(
        self, parameters: Sequence[Any]
    ) -> tuple[dict[int, Any], dict[int, SetParametersResult]]:
        """Those that change anything, converted, and those that cannot be set, by their places."""
        node, wanted, refused = self._get_node(), {}, {}
        for index, each in enumerate(parameters):
            try:
                if not node.has_parameter(each.name):
                    raise ParameterError(each.name, 'this node has no such parameter')
                # rclpy, which looks at the type first, would call 0 the wrong type of a float.
                given = self._convert(Parameter.from_parameter_msg(each)).to_parameter_msg()
                if node.get_parameter(each.name).to_parameter_msg().value != given.value:
                    if node.describe_parameter(each.name).read_only:
                        later = '' if each.name.startswith(_AT_THE_START) else _UNTIL_CONFIGURED
                        raise ParameterError(each.name, f'can be set at the start{later}')
                    wanted[index] = given
            except ParameterError as error:
                refused[index] = SetParametersResult(successful=False, reason=str(error))
        return wanted, refused

    def _set_parameters_callback(
        self, request: SetParameters.Request, response: SetParameters.Response
    ) -> SetParameters.Response:
        results = [SetParametersResult(successful=True) for _ in request.parameters]
        wanted, refused = self._changes(request.parameters)
        for index, result in refused.items():
            results[index] = result
        waiting = [*wanted]
        while waiting:
            again = SetParameters.Request(parameters=[wanted[i] for i in waiting])
            answer = super()._set_parameters_callback(again, SetParameters.Response())
            for index, result in zip(waiting, answer.results, strict=True):
                results[index] = result
            rejected = [i for i in waiting if not results[i].successful]
            if rejected == waiting:
                break
            waiting = rejected
        response.results = results
        return response


class LiveParameters(Generic[P]):
    """Declares a parameter set on a node and follows its changes; ``current`` is always valid."""

    def __init__(
        self, node: Node, parameters_type: type[P], on_change: Callable[[P], None]
    ) -> None:
        """Declare all parameters, taking values from the command line or a YAML file.

        The node was made with ``start_parameter_services=False``; ``on_change`` is called with the
        whole new set after a change.

        Raises:
            ParameterError: a given value is not valid.
        """
        self._specs = {spec.name: spec for spec in parameters_type.specs()}
        self._on_change = on_change
        # Not by declaring them: rclpy would raise on an integer for a float.
        self.current = parameters_type.from_mapping(self._ours(node._parameter_overrides.values()))
        for name, spec in self._specs.items():
            value = _for_ros(getattr(self.current, name))
            node.declare_parameter(name, value, _descriptor(spec), ignore_override=True)
        self._node = node
        self.freeze(False)
        self._service = _SetInAnyOrder(node, self._converted)
        node.add_pre_set_parameters_callback(self._convert)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def freeze(self, frozen: bool) -> None:
        """Make what is `read_only` so, from `configure` to `cleanup`, but for what always is."""
        for name, spec in self._specs.items():
            if spec.read_only and not name.startswith(_AT_THE_START):
                self._node.describe_parameter(name).read_only = frozen

    def _ours(self, parameters: Iterable[Parameter]) -> dict[str, object]:
        return {p.name: p.value for p in parameters if p.name in self._specs}

    def _convert(self, parameters: list[Parameter]) -> list[Parameter]:
        """Turn whole numbers into floats, say, before rclpy checks the type."""
        converted = list(parameters)
        for index, given in enumerate(parameters):
            # Where it cannot be converted the check after this says why.
            with suppress(ParameterError):
                converted[index] = self._converted(given)
        return converted

    def _converted(self, given: Parameter) -> Parameter:
        spec = self._specs.get(given.name)
        if spec is None:
            return given
        return Parameter(given.name, value=_for_ros(spec.convert(given.value)))

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            self.current.changed(self._ours(parameters))
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Parameter]) -> None:
        ours = self._ours(parameters)
        if ours:
            self.current = self.current.changed(ours)
            self._on_change(self.current)


def _for_ros(value: Value) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _descriptor(spec: ParameterSpec) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=write_description(spec),
        read_only=spec.read_only,
        additional_constraints=spec.constraint,
    )
    if spec.limits is not None:
        low, high = spec.limits
        if spec.type is float:
            ends = FloatingPointRange(from_value=float(low), to_value=float(high))
            descriptor.floating_point_range = [ends]
        elif spec.type is int:
            ends = IntegerRange(from_value=int(low), to_value=int(high))
            descriptor.integer_range = [ends]
    return descriptor


def unused_overrides(node: Node, siblings: Sequence[Node] = ()) -> str:
    """Say which parameters, given at the start, are no one's, each with the nearest right name.

    The command line was given to all ``siblings``, the nodes of the process. Overrides of QoS count
    only where a node is active, as it declares them with its topics. Empty where all are used.
    """
    nodes = {node, *siblings}
    known = {name for each in nodes for name in each._parameters}
    states = {getattr(each, 'lifecycle_state', '') for each in nodes}
    has_topics = states <= {'active', 'activating'}
    said = []
    for name in sorted(set(node._parameter_overrides) - known):
        if name.startswith('qos_overrides.') and not has_topics:
            continue
        owners = [other for other, kind in NODE_PARAMETERS.items() if name in kind.names()]
        near = get_close_matches(name, known, 1)
        if owners:
            hint = f' (it is one of {" and ".join(owners)})'
        else:
            hint = f' (did you mean {near[0]}?)' if near else ''
        said.append(name + hint)
    said += parameter_files(node)[1]
    return f'parameters without effect: {", ".join(said)}' if said else ''


def parameter_files(node: Node) -> tuple[list[str], list[str]]:
    """The ``--params-file`` arguments of the command line, and what is wrong with some.

    Of a file without values for the node the first say so; the second say it of one whose values
    are for a node of the same name in another namespace.
    """
    files, mistaken = [], []
    name = node.get_fully_qualified_name()
    for option, file in pairwise(sys.argv):
        if option == '--params-file':
            try:
                keys = read_node_keys(Path(file))
            except ParameterError as error:
                # Its values, if it has some, were taken at the start.
                files.append(f'{file} ({error.reason})')
                continue
            is_ours = any(fits(key, name) for key in keys)
            files.append(file if is_ours else f'{file} (nothing in it for {name})')
            meant = [key for key in keys if key.rsplit('/', 1)[-1] == node.get_name()]
            if meant and not is_ours:
                right = f'write /**/{node.get_name()} for {name}'
                mistaken.append(f'those of {meant[0]} in {file} ({right})')
    return files, mistaken

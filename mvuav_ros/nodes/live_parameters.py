"""A node's ROS parameters from its frozen dataclass."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_service import ParameterService

from mvuav_ros.parameters.declaration import ParameterError, ParameterSet, ParameterSpec, Value

P = TypeVar('P', bound=ParameterSet)


class _SetInAnyOrder(ParameterService):
    """Answers ``set_parameters`` whatever the order of the values.

    rclpy sets the values of one request one by one. ``ros2 param load`` of other rows would fail
    half-way where the new end lies before the old start, so refused values are tried again once
    others have been accepted.
    """

    def _set_parameters_callback(
        self, request: SetParameters.Request, response: SetParameters.Response
    ) -> SetParameters.Response:
        super()._set_parameters_callback(request, response)
        refused = [i for i, result in enumerate(response.results) if not result.successful]
        while 0 < len(refused) < len(request.parameters):
            again = SetParameters.Request(parameters=[request.parameters[i] for i in refused])
            answer = super()._set_parameters_callback(again, SetParameters.Response())
            for index, result in zip(refused, answer.results, strict=True):
                response.results[index] = result
            left = [i for i in refused if not response.results[i].successful]
            if left == refused:
                break
            refused = left
        return response


class LiveParameters(Generic[P]):
    """Declares a parameter set on a node and follows its changes.

    ``current`` is always a valid set. A value that is refused leaves it as it was, and
    ``ros2 param set`` shows the reason.
    """

    def __init__(
        self, node: Node, parameters_type: type[P], on_change: Callable[[P], None]
    ) -> None:
        """Declare all parameters, taking values from the command line or a YAML file.

        Args:
            node: the node to declare them on, made with ``start_parameter_services=False``.
            parameters_type: the set.
            on_change: called with the whole new set after a change.

        Raises:
            ParameterError: a given value is not valid.
        """
        self._specs = {spec.name: spec for spec in parameters_type.specs()}
        self._on_change = on_change
        given = {name: _given_value(node, spec) for name, spec in self._specs.items()}
        self.current = parameters_type.from_mapping(given)
        for spec in self._specs.values():
            node.declare_parameter(
                spec.name,
                _for_ros(getattr(self.current, spec.name)),
                _descriptor(spec),
                ignore_override=True,
            )
        self._service = _SetInAnyOrder(node)
        node.add_pre_set_parameters_callback(self._convert)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def _ours(self, parameters: Sequence[Parameter]) -> dict[str, object]:
        return {p.name: p.value for p in parameters if p.name in self._specs}

    def _convert(self, parameters: list[Parameter]) -> list[Parameter]:
        """Turn whole numbers into floats before rclpy checks the type."""
        return [self._with_floats(parameter) for parameter in parameters]

    def _with_floats(self, given: Parameter) -> Parameter:
        spec = self._specs.get(given.name)
        if spec is None:
            return given
        if spec.type is float and given.type_ is Parameter.Type.INTEGER:
            return Parameter(given.name, Parameter.Type.DOUBLE, float(given.value))
        if spec.type is tuple and given.type_ is Parameter.Type.INTEGER_ARRAY:
            numbers = [float(number) for number in given.value]
            return Parameter(given.name, Parameter.Type.DOUBLE_ARRAY, numbers)
        return given

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


def _given_value(node: Node, spec: ParameterSpec) -> object:
    """The value from the command line or YAML, else the default.

    Declared once with a free type to see what was given: declaring with the right type at once
    raises on an integer for a float, before anything could convert it.
    """
    value = node.declare_parameter(
        spec.name, _for_ros(spec.default), ParameterDescriptor(dynamic_typing=True)
    ).value
    node.undeclare_parameter(spec.name)
    return value


def _for_ros(value: Value) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _descriptor(spec: ParameterSpec) -> ParameterDescriptor:
    words = [spec.description]
    if spec.unit:
        words.append(f'Unit: {spec.unit}.')
    if spec.thesis:
        words.append(f'Thesis: {spec.thesis}.')
    descriptor = ParameterDescriptor(
        description=' '.join(words),
        read_only=spec.read_only,
        additional_constraints=spec.constraint,
    )
    if spec.minimum is not None and spec.maximum is not None:
        if spec.type is float:
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(spec.minimum), to_value=float(spec.maximum))
            ]
        elif spec.type is int:
            descriptor.integer_range = [
                IntegerRange(from_value=int(spec.minimum), to_value=int(spec.maximum))
            ]
    return descriptor

"""Another node's parameters, asked for and set without ever waiting for it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python

from mvuav_ros.panel import foreign
from mvuav_ros.panel.controls import Control, control_of
from mvuav_ros.panel.ros_thread import RosThread
from mvuav_ros.parameters.declaration import Value

_SERVICES = {
    'list_parameters': ListParameters,
    'describe_parameters': DescribeParameters,
    'get_parameters': GetParameters,
    'set_parameters': SetParameters,
}
_MOST = 500
"""Parameters shown; more are no vision node's."""


class RemoteParameters:
    """Clients for one node; make and close it in the ROS thread."""

    def __init__(self, ros: RosThread, name: str) -> None:
        """Make the clients.

        Args:
            ros: our own node.
            name: the other node's, fully qualified.
        """
        self._ros = ros
        self._clients: dict[str, Any] = {
            service: ros.node.create_client(kind, f'{name}/{service}')
            for service, kind in _SERVICES.items()
        }

    def close(self) -> None:
        """Destroy the clients."""
        for client in self._clients.values():
            self._ros.node.destroy_client(client)

    async def describe(self) -> list[Control]:
        """Every parameter's control, in the order of declaration where the node keeps it.

        Raises:
            NoAnswerError: the node does not answer.
        """
        listed = (await self._ask('list_parameters', ListParameters.Request())).result.names
        short = [name for name in dict.fromkeys(listed) if 0 < len(name) <= foreign.LONGEST_NAME]
        names = short[:_MOST]
        answer = await self._ask('describe_parameters', DescribeParameters.Request(names=names))
        controls = {each.name: control_of(each) for each in answer.descriptors}
        return [controls[name] for name in names if name in controls]

    async def get(self, names: list[str]) -> dict[str, Any]:
        """Current values.

        Raises:
            NoAnswerError: the node does not answer.
        """
        answer = await self._ask('get_parameters', GetParameters.Request(names=names))
        values = [value_of(value) for value in answer.values]
        return dict(zip(names, values, strict=False))

    async def set(self, values: Mapping[str, Value]) -> dict[str, str]:
        """Set values in one request.

        Returns:
            The node's reason for each that it refused.

        Raises:
            NoAnswerError: the node does not answer.
        """
        try:
            messages = [Parameter(n, value=v).to_parameter_msg() for n, v in values.items()]
        except (AssertionError, OverflowError, TypeError, ValueError) as error:
            return dict.fromkeys(values, f'cannot be sent: {foreign.words(error)}')
        request = SetParameters.Request(parameters=messages)
        answer = await self._ask('set_parameters', request)
        return {
            name: _plain(name, result.reason)
            for name, result in zip(values, answer.results, strict=False)
            if not result.successful
        }

    async def _ask(self, service: str, request: Any) -> Any:
        return await self._ros.request(self._clients[service], request)


def value_of(message: Any) -> Any:
    """A rcl_interfaces/ParameterValue; None where its type is none that there is."""
    try:
        return foreign.parameter_value(parameter_value_to_python(message))
    except RuntimeError:
        return None


def _plain(name: str, reason: str) -> str:
    return foreign.words(reason.removeprefix(f'{name}: ')) or 'refused without a reason'

"""Another node's parameters, asked for and set without ever waiting for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python

from mvuav_ros.panel import foreign
from mvuav_ros.panel.controls import Control, control_of
from mvuav_ros.panel.ros_thread import RosThread
from mvuav_ros.parameters.declaration import Value

_MOST = 500
"""Parameters shown; more are no vision node's."""


class RemoteParameters:
    """Clients for one node; every method raises NoAnswerError where it does not answer."""

    def __init__(self, ros: RosThread, name: str) -> None:
        self._ros = ros
        client = ros.node.create_client
        self._list = client(ListParameters, f'{name}/list_parameters')
        self._describe = client(DescribeParameters, f'{name}/describe_parameters')
        self._get = client(GetParameters, f'{name}/get_parameters')
        self._set = client(SetParameters, f'{name}/set_parameters')

    def close(self) -> None:
        """Destroy the clients."""
        for client in (self._list, self._describe, self._get, self._set):
            self._ros.node.destroy_client(client)

    async def describe(self) -> list[Control]:
        """Every parameter's control, in the order of declaration where the node keeps it."""
        listed = await self._ros.request(self._list, ListParameters.Request())
        said = dict.fromkeys(listed.result.names)
        names = [name for name in said if 0 < len(name) <= foreign.LONGEST_NAME][:_MOST]
        request = DescribeParameters.Request(names=names)
        answer = await self._ros.request(self._describe, request)
        controls = {each.name: control_of(each) for each in answer.descriptors}
        return [controls[name] for name in names if name in controls]

    async def get(self, names: Sequence[str]) -> dict[str, Any]:
        """Current values."""
        answer = await self._ros.request(self._get, GetParameters.Request(names=names))
        return dict(zip(names, map(value_of, answer.values), strict=False))

    async def set(self, values: Mapping[str, Value]) -> dict[str, str]:
        """Set values in one request; returns the reason for each that was refused."""
        try:
            messages = [Parameter(n, value=v).to_parameter_msg() for n, v in values.items()]
        except (AssertionError, OverflowError, TypeError, ValueError) as error:
            return dict.fromkeys(values, f'cannot be sent: {foreign.words(error)}')
        answer = await self._ros.request(self._set, SetParameters.Request(parameters=messages))
        return {
            name: foreign.words(said.reason.removeprefix(f'{name}: ')) or 'refused without a reason'
            for name, said in zip(values, answer.results, strict=False)
            if not said.successful
        }


def value_of(message: Any) -> Any:
    """A rcl_interfaces/ParameterValue; None where its type is none that there is."""
    try:
        return foreign.parameter_value(parameter_value_to_python(message))
    except RuntimeError:
        return None

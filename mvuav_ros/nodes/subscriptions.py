"""Subscriptions that a thread of their own takes from, and not rclpy's executor."""

from __future__ import annotations

import copy
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import (
    QoSSubscriptionEventType,
    SubscriptionEventCallbacks,
    UnsupportedEventTypeError,
)
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.qos_overriding_options import QoSOverridingOptions


class _OwnThread(CallbackGroup):
    """Keeps the executor away."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        pass


def subscribe(node: Node, kind: type, topic: str, *, raw: bool = False) -> Any:
    """A subscription with the QoS of sensor data and ``qos_overrides``; ``raw`` gives bytes."""
    return node.create_subscription(
        kind,
        topic,
        _not_called,
        # A copy: rclpy writes the user's overrides into it.
        copy.copy(qos_profile_sensor_data),
        callback_group=_OwnThread(),
        # An executor that waits for a subscription's events wakes up for its data as well, on
        # Fast DDS, and again and again until this thread has taken them.
        event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        raw=raw,
    )


def status_of(subscription: Any, name: str) -> Any:
    """A status of a subscription that can be asked for; None if not supported."""
    kind = getattr(QoSSubscriptionEventType, f'RCL_SUBSCRIPTION_{name}')
    try:
        with subscription.handle:
            return rclpy_implementation.EventHandle(subscription.handle, kind)
    except UnsupportedEventTypeError:
        return None


def _not_called(_message: Any) -> None:
    raise AssertionError('the executor does not take images')

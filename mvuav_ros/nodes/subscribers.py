"""Whether anybody listens."""

from __future__ import annotations

from typing import Any

from rclpy.qos import DurabilityPolicy


def is_heard(publisher: Any) -> bool:
    """Whether a message would reach a subscriber, now or, transient local, as a late joiner."""
    return bool(
        publisher.get_subscription_count() > 0
        or publisher.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    )

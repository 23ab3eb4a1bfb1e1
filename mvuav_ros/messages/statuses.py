"""Results in words and numbers as diagnostic_msgs/DiagnosticArray."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from mvuav_ros.messages.cdr import CdrWriter
from mvuav_ros.vision.integrity import (
    IntegrityState,
    ProtectionLevels,
    RunwayLevels,
    integrity_state,
)

OK, WARN, ERROR = 0, 1, 2
"""Of diagnostic_msgs/DiagnosticStatus."""


class Status(NamedTuple):
    """A diagnostic_msgs/DiagnosticStatus, its values as text."""

    level: int
    name: str
    message: str
    values: dict[str, str]


def encode_statuses(statuses: Sequence[Status], header: bytes) -> bytes:
    """A DiagnosticArray in CDR; ``header`` is a `cdr_header`."""
    writer = CdrWriter(header)
    writer.numbers('I', len(statuses))
    for level, name, message, values in statuses:
        writer.numbers('B', level)
        writer.text(name)
        writer.text(message)
        hardware_id = ''
        writer.text(hardware_id)
        writer.numbers('I', len(values))
        for key, value in values.items():
            writer.text(key)
            writer.text(value)
    return writer.message()


def texts(**values: float | bool) -> dict[str, str]:
    """Values as a reader of ``ros2 topic echo`` sees them."""
    return {
        key: f'{value:.4f}' if isinstance(value, float) else str(value).lower()
        for key, value in values.items()
    }


def encode_integrity(
    levels: ProtectionLevels | RunwayLevels,
    alert_limits: Sequence[float],
    risk: float,
    header: bytes,
) -> bytes:
    """A DiagnosticArray with one status: OK available, WARN alert, ERROR not available.

    Its values are the levels (m; degrees where the key says so), the alert limits and the
    integrity risk per frame.
    """
    state = integrity_state(levels, alert_limits)
    message = state.name.lower().replace('_', ' ')
    if reason := levels.reason or ', '.join(levels.beyond(alert_limits)):
        message += f': {reason}'
    if isinstance(levels, ProtectionLevels):
        name = 'pose'
        axes: tuple[str, ...] = ('along', 'across', 'up')
        values = texts(
            along=levels.along,
            across=levels.across,
            up=levels.up,
            horizontal=levels.horizontal,
            vertical=levels.vertical,
            roll_deg=math.degrees(levels.roll),
            pitch_deg=math.degrees(levels.pitch),
            yaw_deg=math.degrees(levels.yaw),
        )
    else:
        name, axes = 'runway', ('offset', 'height')
        values = texts(
            offset=levels.offset,
            height=levels.height,
            heading_deg=math.degrees(levels.heading),
        )
    for axis, limit in zip(axes, alert_limits, strict=True):
        values[f'alert_limit_{axis}'] = f'{limit:g}' if limit else 'none'
    values['risk'] = f'{risk:g}'
    return encode_statuses([Status(_LEVELS[state], name, message, values)], header)


_LEVELS = {
    IntegrityState.AVAILABLE: OK,
    IntegrityState.ALERT: WARN,
    IntegrityState.NOT_AVAILABLE: ERROR,
}

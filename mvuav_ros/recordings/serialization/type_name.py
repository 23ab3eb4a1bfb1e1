"""The names of message classes."""

from __future__ import annotations

from functools import cache


@cache
def type_name(kind: type) -> str:
    """A message class as ``pkg/msg/Type``."""
    return f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'

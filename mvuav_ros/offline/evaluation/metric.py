"""A number that says something of a run."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple


class Metric(NamedTuple):
    """One number; metrics of one group are drawn together, since they have one unit."""

    group: str
    name: str
    unit: str
    value: float

    @property
    def cell(self) -> int | float:
        """The value; counts as whole numbers."""
        whole = not self.unit and self.value.is_integer()
        return int(self.value) if whole else self.value

    @property
    def column(self) -> str:
        """Name and unit."""
        return f'{self.name} [{self.unit}]' if self.unit else self.name


def metric_groups(runs: Iterable[Iterable[Metric]]) -> dict[str, list[str]]:
    """Columns by group, without those that have no number at all.

    Args:
        runs: the metrics of each.
    """
    groups: dict[str, list[str]] = {}
    for metrics in runs:
        for metric in metrics:
            names = groups.setdefault(metric.group, [])
            if metric.column not in names and not math.isnan(metric.value):
                names.append(metric.column)
    return {group: names for group, names in groups.items() if names}

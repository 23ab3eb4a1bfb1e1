"""Trends of saved runs as PNG, drawn as ``mvuav sweep`` does; imports much, and so only then."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mvuav_ros.offline.report.model import Figure
from mvuav_ros.offline.sweep.report import trend_image
from mvuav_ros.offline.sweep.run import Run, RunResult
from mvuav_ros.panel.runs import SavedRun


def as_results(runs: Sequence[SavedRun]) -> list[RunResult]:
    """Runs in the form in which ``mvuav sweep`` draws and writes them."""
    return [
        RunResult(
            Run(number, Path(run.source).name, (run.name,), {run.kind: run.parameters}),
            run.metrics,
        )
        for number, run in enumerate(runs, 1)
    ]


def image_of(runs: Sequence[SavedRun], arrangement: str, group: str) -> Figure:
    """The trends of some runs in one figure; see `trend_image`."""
    return trend_image(as_results(runs), arrangement, group, [run.name for run in runs])

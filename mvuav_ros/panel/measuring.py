"""A replay's numbers; imports much, and so only in the process of a run."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path

import mvuav_ros
from mvuav_ros.offline.evaluation.bag_report import bag_report
from mvuav_ros.offline.evaluation.evaluation_run import read_bag
from mvuav_ros.offline.evaluation.metrics import metrics_of
from mvuav_ros.offline.replay.job import ReplayOutcome
from mvuav_ros.offline.report.writing import write_report
from mvuav_ros.panel.runs import REPORT, SavedRun
from mvuav_ros.parameters.declaration import Value


def measured_run(
    name: str,
    kind: str,
    source: str,
    parameters: Mapping[str, Value],
    outcome: ReplayOutcome,
    settings: str = '',
) -> SavedRun:
    """The numbers of a replay that has ended.

    A run with a name gets a report beside its results.

    Raises:
        RecordingError: the results or the recording cannot be read.
    """
    observed = read_bag(Path(outcome.output))
    observed.truth = read_bag(Path(source)).truth
    observed.frames = outcome.frames
    observed.rejected = outcome.frames - outcome.processed
    if name:
        described = {key: str(value) for key, value in parameters.items()}
        write_report(bag_report(observed, described), Path(outcome.output).parent / REPORT)
    metrics = [metric for metric in metrics_of(observed) if metric.name != 'time per frame']
    return SavedRun(
        name=name,
        kind=kind,
        source=source,
        parameters=dict(parameters),
        metrics=tuple(metrics),
        version=mvuav_ros.__version__,
        made=time.time(),
        frames=outcome.frames,
        answered=outcome.processed,
        settings=settings,
    )

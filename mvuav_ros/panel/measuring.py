"""A replay's numbers; imports much, and so only in the process of a run."""

from __future__ import annotations

import time
from pathlib import Path

import mvuav_ros
from mvuav_ros.offline.evaluation.bag_report import bag_report
from mvuav_ros.offline.evaluation.evaluation_run import read_bag
from mvuav_ros.offline.evaluation.metrics import metrics_of
from mvuav_ros.offline.replay.job import ReplayOutcome
from mvuav_ros.offline.report.writing import write_report
from mvuav_ros.panel.run_process import RunRequest
from mvuav_ros.panel.runs import REPORT, SavedRun


def measured_run(request: RunRequest, outcome: ReplayOutcome) -> SavedRun:
    """The numbers of a replay that has ended.

    A run with a name gets a report beside its results.

    Raises:
        RecordingError: the results or the recording cannot be read.
    """
    observed = read_bag(Path(outcome.output))
    observed.truth = read_bag(request.source).truth
    observed.frames = outcome.frames
    observed.rejected = outcome.frames - outcome.processed
    if request.name:
        described = {key: str(value) for key, value in request.parameters.items()}
        write_report(bag_report(observed, described), Path(outcome.output).parent / REPORT)
    return SavedRun(
        name=request.name,
        kind=request.kind,
        source=str(request.source),
        parameters=dict(request.parameters),
        metrics=tuple(m for m in metrics_of(observed) if m.name != 'time per frame'),
        version=mvuav_ros.__version__,
        made=time.time(),
        frames=outcome.frames,
        answered=outcome.processed,
        settings=request.settings,
    )

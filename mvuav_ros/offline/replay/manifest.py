"""What a batch of replays did, as ``manifest.json`` beside its outputs."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import mvuav_ros
from mvuav_ros.offline.replay.job import ReplayJob, ReplayOutcome
from mvuav_ros.offline.replay.records import fingerprint

MANIFEST = 'manifest.json'


def write_manifest(
    folder: Path, jobs: Sequence[ReplayJob], outcomes: Sequence[ReplayOutcome], started: datetime
) -> None:
    """Replace the folder's manifest: version, times, and for each recording its outcome.

    Args:
        folder: of the outputs.
        jobs: all of the batch.
        outcomes: of those that came to an end.
        started: the time at which the batch began, UTC.

    Raises:
        OSError: it cannot be written.
    """
    by_output = {outcome.output: outcome for outcome in outcomes}
    content = {
        'version': mvuav_ros.__version__,
        'started': started.isoformat(),
        'ended': datetime.now(UTC).isoformat(),
        'settings': dataclasses.asdict(jobs[0].settings),
        'recordings': [_entry(job, by_output.get(job.output)) for job in jobs],
    }
    # In one step: whoever reads it finds the old one or the new one.
    beside = folder / f'.{MANIFEST}.{os.getpid()}'
    beside.write_text(json.dumps(content, indent=2), encoding='utf-8')
    beside.replace(folder / MANIFEST)


def _entry(job: ReplayJob, outcome: ReplayOutcome | None) -> dict[str, Any]:
    size = job.output.stat().st_size if job.output.is_file() else 0
    return {
        **_input(job.source),
        'output': job.output.name,
        'output_bytes': size,
        'outcome': _word(outcome),
        **({} if outcome is None else {**outcome.counts(), 'failure': outcome.failure}),
    }


def _input(source: str) -> dict[str, str]:
    try:
        return fingerprint(source)
    except Exception:  # whatever kept it from being read is told by its outcome
        return {'input': source}


def _word(outcome: ReplayOutcome | None) -> str:
    if outcome is None or outcome.interrupted:
        return 'interrupted'
    if outcome.failure:
        return 'failed'
    return 'finished before' if outcome.done_before else 'finished'

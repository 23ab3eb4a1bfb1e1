"""What a batch of replays did, as ``manifest.json`` beside its outputs: what the next one reads."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import time
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import mvuav_ros
from mvuav_ros.offline.replay.job import ReplayJob, ReplayOutcome, is_own_input
from mvuav_ros.offline.replay.provenance import description
from mvuav_ros.recordings.remote import inside, read_text, size_at, write_text

MANIFEST = 'manifest.json'

_FINISHED = ('finished', 'finished before')
_REDONE = ('begun', 'interrupted', 'failed')
_COUNTS = ('frames', 'processed', 'rejected', 'errors', 'warnings')
_WRITING_INTERVAL = 1.0
"""Seconds between two versions of the file; a batch that is killed loses the last one at most."""


class Manifest:
    """A folder's manifest: version, settings, times, and for each recording its outcome.

    It is written when the batch begins, while it runs and when it ends. Recordings of earlier
    batches into the same folder stay in it.
    """

    def __init__(self, folder: str, jobs: Sequence[ReplayJob]) -> None:
        """Read what an earlier batch left.

        Args:
            folder: of the outputs, or its URL.
            jobs: all of the batch.

        Raises:
            RecordingError: the folder cannot be reached.
            OSError: likewise.
        """
        self._place = inside(folder, MANIFEST)
        self._settings = dataclasses.asdict(jobs[0].settings)
        self._started = datetime.now(UTC).isoformat()
        self._written = 0.0
        self._known = _entries(read_text(self._place))
        self._made_from = {job.output: _made_from(job) for job in jobs}

    def begin(self, jobs: Sequence[ReplayJob]) -> tuple[list[ReplayOutcome], list[ReplayJob]]:
        """The outcomes that are known without any work, and the jobs that are to be done.

        An output that is finished is left as it is, one that was begun is made again, and any
        other file is in the way, unless its job may overwrite it.

        Raises:
            RecordingError: the manifest cannot be written.
            OSError: likewise.
        """
        settled, to_do = [], []
        for job in jobs:
            outcome = self._settled(job)
            if outcome is None:
                to_do.append(dataclasses.replace(job, overwrite=True))
                self._note(job.output, 'begun', {})
            else:
                settled.append(outcome)
        self._write()
        return settled, to_do

    def take(self, outcome: ReplayOutcome) -> None:
        """Note what became of a job.

        Raises:
            RecordingError: the manifest cannot be written.
            OSError: likewise.
        """
        counts = {name: getattr(outcome, name) for name in (*_COUNTS, 'failure')}
        self._note(outcome.output, _word(outcome), counts)
        if time.monotonic() > self._written + _WRITING_INTERVAL:
            self._write()

    def end(self) -> None:
        """Write the last version; what was not done by now is said to be interrupted.

        Raises:
            RecordingError: the manifest cannot be written.
            OSError: likewise.
        """
        for entry in self._known.values():
            if entry['outcome'] == 'begun':
                entry['outcome'] = 'interrupted'
        self._write()

    def _settled(self, job: ReplayJob) -> ReplayOutcome | None:
        size = size_at(job.output)
        if job.overwrite or size is None or is_own_input(job):  # `run_job` refuses the last
            return None
        known = self._known.get(_name(job.output), {})
        if self._made_from[job.output].items() <= known.items():
            if known['outcome'] in _REDONE:
                return None
            if known['outcome'] in _FINISHED and known['output_bytes'] == size:
                known['outcome'] = 'finished before'
                done = ReplayOutcome(job.source, job.output, done_before=True)
                vars(done).update({name: known[name] for name in _COUNTS})
                done.rejected = Counter(done.rejected)
                return done
        elif not known:
            self._note(job.output, 'refused', {})
        return ReplayOutcome(
            job.source,
            job.output,
            failure=f'{job.output} exists, but {MANIFEST} does not say that it was made from this '
            'input by this version with these parameters; --force overwrites it',
        )

    def _note(self, output: str, word: str, counts: dict[str, Any]) -> None:
        self._known[_name(output)] = {
            **self._made_from[output],
            'output': _name(output),
            'output_bytes': 0 if word in ('begun', 'refused') else size_at(output) or 0,
            'outcome': word,
            'noted': datetime.now(UTC).isoformat(),
            **counts,
        }

    def _write(self) -> None:
        content = {
            'version': mvuav_ros.__version__,
            'started': self._started,
            'ended': datetime.now(UTC).isoformat(),
            'settings': self._settings,
            'recordings': list(self._known.values()),
        }
        write_text(self._place, json.dumps(content, indent=2))
        self._written = time.monotonic()


def _entries(text: str) -> dict[str, dict[str, Any]]:
    """The recordings of an earlier manifest by their outputs; none of a damaged one."""
    try:
        entries = {str(entry['output']): entry for entry in json.loads(text)['recordings']}
    except (ValueError, KeyError, TypeError):
        return {}
    needed = {'outcome', 'output_bytes', 'version'}
    return {name: entry for name, entry in entries.items() if needed <= entry.keys()}


def _made_from(job: ReplayJob) -> dict[str, str]:
    """The job's description, with a digest of the settings, which are the same for all."""
    try:
        made_from = description(job.source, job.settings)
    except Exception:  # whatever keeps it from being read is told by its outcome
        return {'version': mvuav_ros.__version__, 'input': job.source}
    settings = made_from.pop('settings')
    return {**made_from, 'settings_sha256': hashlib.sha256(settings.encode()).hexdigest()}


def _name(output: str) -> str:
    return output.rstrip('/').rpartition('/')[2]


def _word(outcome: ReplayOutcome) -> str:
    if outcome.interrupted:
        return 'interrupted'
    return 'failed' if outcome.failure else 'finished'

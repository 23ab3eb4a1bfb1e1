"""Runs over recordings, each in a process of its own and into a folder of its own."""

from __future__ import annotations

import asyncio
import json
import math
import os
import shutil
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain, count
from pathlib import Path

import mvuav_ros
from mvuav_ros.offline.evaluation.metrics import Metric
from mvuav_ros.offline.replay.job import ReplayJob, ReplaySettings, attempt
from mvuav_ros.offline.report import PAGE, Cell, Column, Table
from mvuav_ros.offline.stopping import Stop
from mvuav_ros.offline.tasks import ProcessDiedError, Report, TaskProgress, Worker
from mvuav_ros.panel import sanitized
from mvuav_ros.panel.sanitized import NameRefusedError, checked_name
from mvuav_ros.parameters.declaration import Value, default_text
from mvuav_ros.processing.registry import PROCESSORS
from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.layout import BAG_SUFFIXES, METADATA, plain_name
from mvuav_ros.sources.bag import BagImages

RESULTS = 'results.mcap'
REPORT = 'report'
_SUMMARY = 'run.json'
_MAX_BAGS, _MAX_METRICS = 500, 200
_MAX_SUMMARY = 1_000_000
_TOPICS = ('image_topic', 'imu_topic', 'camera_info_topic')
_WORDS = ('source', *_TOPICS, 'lost', 'version')
"""Fields of a run that are text."""
_MAX_TIME = 253_402_300_799.0
"""s since the epoch: the end of the year 9999."""
_ENDING_TIME = 5.0
_NICENESS = 5


@dataclass(frozen=True)
class Run:
    """A kind of node with some parameters over a recording, and what came of it.

    A run without a name is not kept. ``image_topic`` is empty where the recording has images of
    one topic only, ``camera_info_topic`` and ``imu_topic`` where no calibration or no attitude was
    used. It was made in s since the epoch; ``answered`` of the frames have a result, and the
    metrics are those of ``mvuav sweep``. ``lost`` says what could not be read of the recording.
    """

    name: str
    kind: str
    source: str
    parameters: dict[str, Value]
    image_topic: str = ''
    camera_info_topic: str = ''
    imu_topic: str = ''
    lost: str = ''
    version: str = mvuav_ros.__version__
    made: float = 0.0
    frames: int = 0
    answered: int = 0
    metrics: tuple[Metric, ...] = ()


class Runner:
    """The run of the whole process, one at a time, in a process beside the panel.

    ``words`` and ``fraction`` say how far it is or how it ended, ``last`` is the newest finished;
    ``on_change`` is called whenever they change.
    """

    def __init__(self, store: RunStore, on_change: Callable[[], object]) -> None:
        self._store, self._on_change = store, on_change
        self._worker: Worker | None = None
        self.is_busy = self._cancelled = False
        self.words, self.fraction = '', 0.0
        self.last: Run | None = None

    async def replay(self, run: Run, folder: Path) -> bool:
        """Replay a recording with a node's code, measure its results, and say whether it worked.

        They go into the folder, with a report; without a name, or where it fails, that goes again.
        """
        self.is_busy, self._cancelled, keep = True, False, False
        self._show('starting', 0.0)
        try:
            run = await self._measured(run, folder)
            if run.name:
                self._store.finish(run, folder)
                keep = True
            self.last = run
            lost = f'; {run.lost}' if run.lost else ''
            self._show(f'{run.answered} of {run.frames} frames{lost}', 1.0)
            return True
        except (RecordingError, OSError, ProcessDiedError) as error:
            self.words = 'cancelled' if self._cancelled else f'failed: {error}'
            return False
        finally:
            if not keep:
                shutil.rmtree(folder, ignore_errors=True)
            self.is_busy = False
            self._on_change()

    def cancel(self) -> None:
        """End the run."""
        self._cancelled = True
        if self._worker is not None:
            self._worker.request_stop()

    async def _measured(self, run: Run, folder: Path) -> Run:
        # Spawned: a forked child would lack the threads of ROS.
        worker = self._worker = await asyncio.to_thread(Worker, _measured_replay)
        try:
            worker.send(0, (run, folder))
            if self._cancelled:
                worker.request_stop()
            while isinstance(said := await asyncio.to_thread(worker.receive), TaskProgress):
                done, total = said.message.done, said.message.total
                words = f'{done} of {total} frames' if total else f'{done} frames'
                self._show(words, done / total if total else 0.0)
        finally:
            self._worker = None
            await asyncio.to_thread(worker.end, _ENDING_TIME)
        if said.error is not None:
            raise RecordingError(str(said.error))
        assert isinstance(said.result, Run)
        return said.result

    def _show(self, words: str, fraction: float) -> None:
        self.words, self.fraction = words, fraction
        self._on_change()


def _measured_replay(task: tuple[Run, Path], report: Report, stop: Stop) -> Run:
    """Runs in the worker; what it imports is much, and for the worker only."""
    from mvuav_ros.offline.evaluation.bag_report import bag_report
    from mvuav_ros.offline.evaluation.evaluation_run import read_bag
    from mvuav_ros.offline.evaluation.metrics import metrics_of
    from mvuav_ros.offline.report import write_report

    os.nice(_NICENESS)
    run, folder = task
    output = folder / RESULTS
    wanted = (getattr(run, each) for each in _TOPICS)
    images = BagImages(Path(run.source), *wanted, or_first=True)
    images.close()
    topics = images.topic, images.imu_topic, images.camera_topic
    settings = ReplaySettings({run.kind: run.parameters}, *topics)
    outcome = attempt(ReplayJob(run.source, str(output), settings), report, stop)
    if outcome.failure or outcome.interrupted:
        raise RecordingError(outcome.failure or 'interrupted')
    observed = read_bag(output)
    observed.truth = read_bag(Path(run.source)).truth
    observed.frames = outcome.frames
    observed.rejected = outcome.frames - outcome.processed
    if run.name:
        described = {key: str(value) for key, value in run.parameters.items()}
        write_report(bag_report(observed, described), folder / REPORT)
    return replace(
        run,
        image_topic=images.topic if len(images.image_topics) > 1 else '',
        camera_info_topic=images.camera_topic or '',
        imu_topic=images.imu_topic or '',
        lost='; '.join(outcome.errors),
        made=time.time(),
        frames=outcome.frames,
        answered=outcome.processed,
        metrics=tuple(m for m in metrics_of(observed) if m.name != 'time per frame'),
    )


class RunStore:
    """The runs of a folder; a name that none can have raises NameRefusedError.

    ``rejected`` are those that the last call of `all` could not read, with the reasons.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.rejected = folder, dict[str, str]()

    def all(self) -> list[Run]:
        """Every complete run, the oldest first."""
        runs, self.rejected = [], {}
        for path in sorted(self.folder.glob(f'[!.]*/{_SUMMARY}')):
            try:
                runs.append(_read(path))
            except Exception as error:
                # It may hold anything, and one such file must not hide the others.
                said = f'{type(error).__name__}: {error}'
                self.rejected[sanitized.words(path.parent.name)] = sanitized.words(said)
        return sorted(runs, key=lambda run: run.made)

    def free_name(self) -> str:
        """A name that no run has."""
        names = (f'run {number}' for number in count(1))
        return next(name for name in names if not (self.folder / name).exists())

    def new_folder(self, name: str) -> Path:
        """Make the folder of a run to come, until `finish`; a name that a run has is refused."""
        name = checked_name(name)
        if (self.folder / name).exists():
            raise NameRefusedError(f'there is a run {name} already')
        folder = self.folder / f'.{name}'
        # Of one that was killed.
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        return folder

    def finish(self, run: Run, folder: Path) -> None:
        """Have a run take its name: all of it is there, or nothing."""
        # JSON has no NaN.
        known = [m.value if math.isfinite(m.value) else None for m in run.metrics]
        metrics = [{**m._asdict(), 'value': v} for m, v in zip(run.metrics, known, strict=True)]
        content = {**vars(run), 'metrics': metrics}
        (folder / _SUMMARY).write_text(json.dumps(content, indent=1, ensure_ascii=False))
        folder.rename(self.folder / checked_name(run.name))

    def delete(self, name: str) -> None:
        """Remove a run."""
        shutil.rmtree(self.folder / checked_name(name), ignore_errors=True)

    def report(self, name: str) -> Path | None:
        """The page of a run's report."""
        with suppress(NameRefusedError):
            page = self.folder / checked_name(name) / REPORT / PAGE
            return page if page.is_file() else None
        return None


def _read(path: Path) -> Run:
    content = json.loads(sanitized.file_text(path, _MAX_SUMMARY))
    number, words = sanitized.number, sanitized.words
    made, frames, answered = (number(content[key]) for key in ('made', 'frames', 'answered'))
    if not (0.0 <= made <= _MAX_TIME and 0.0 <= answered <= frames):
        raise ValueError('made at no time, or over an impossible number of frames')
    return Run(
        # The folder's name counts: a user may have renamed it.
        name=checked_name(path.parent.name),
        kind=PROCESSORS[content['kind']].name,
        parameters={
            words(name): value
            for name, given in dict(content['parameters']).items()
            if (value := sanitized.plain_value(given)) is not None
        },
        metrics=tuple(
            Metric(words(m['group']), words(m['name']), words(m['unit']), number(m['value']))
            for m in content['metrics'][:_MAX_METRICS]
        ),
        made=made,
        frames=int(frames),
        answered=int(answered),
        # Those that older versions did not write are empty.
        **{each: words(content.get(each, ''), sanitized.LONGEST_DESCRIPTION) for each in _WORDS},
    )


def varied(runs: Sequence[Run]) -> list[str]:
    """The parameters that are not the same in all of these runs."""
    names = dict.fromkeys(name for run in runs for name in run.parameters)
    return [n for n in names if len({repr(run.parameters.get(n)) for run in runs}) > 1]


def run_table(runs: Sequence[Run]) -> Table:
    """Everything about runs but their messages: one row each."""
    columns = dict.fromkeys(metric.column for run in runs for metric in run.metrics)
    names = dict.fromkeys(name for run in runs for name in run.parameters)
    rows: list[tuple[Cell, ...]] = []
    for run in runs:
        numbers = {metric.column: metric.cell for metric in run.metrics}
        values = (run.parameters.get(name) for name in names)
        cells = (default_text(value) if isinstance(value, tuple) else value for value in values)
        source = f'{run.source} {run.image_topic}'.rstrip()
        whole = (run.name, run.kind, source, run.version)
        rows.append((*whole, *map(numbers.get, columns), *cells))
    heads = ('run', 'node', 'input', 'version', *columns, *names)
    return Table('runs', 'Runs', tuple(map(Column, heads)), tuple(rows))


def find_bags(folders: Sequence[Path]) -> dict[str, Path]:
    """The recordings below some folders, by the name that the page shows.

    A folder with a rosbag2 ``metadata.yaml`` is one, and so is a file that is named itself. Of two
    of the same name the second is named with its whole path.
    """
    bags: dict[str, Path] = {}
    for folder in folders:
        for path in sorted(folder.rglob('*')) if folder.is_dir() else [folder]:
            is_bag = path == folder or plain_name(path.name).endswith(BAG_SUFFIXES)
            if is_bag and path.is_file() and len(bags) < _MAX_BAGS:
                if folder.is_dir() and (path.parent / METADATA).exists():
                    path = path.parent
                name = str(path.relative_to(folder)) if path != folder else path.name
                names = chain((name, str(path)), (f'{number}: {path}' for number in count(2)))
                if path not in bags.values():
                    bags[next(n for n in map(sanitized.words, names) if n not in bags)] = path
    return bags

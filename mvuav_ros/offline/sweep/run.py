"""Runs over a grid of parameters and several inputs."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mvuav_ros.offline.evaluation.evaluation_run import replay
from mvuav_ros.offline.evaluation.metrics import Metric, metrics_of
from mvuav_ros.offline.node_parameters import PROCESSING_NODES
from mvuav_ros.offline.processes import Done
from mvuav_ros.offline.replay.cluster import connect
from mvuav_ros.offline.tasks import each
from mvuav_ros.parameters.declaration import ParameterError, Value
from mvuav_ros.parameters.parameter_file import NODE_PARAMETERS, parse_assignment


@dataclass(frozen=True)
class Axis:
    """A parameter and the values that it takes in turn."""

    node: str
    name: str
    values: tuple[Value, ...]

    @property
    def title(self) -> str:
        """As the user wrote it."""
        return f'{self.node}:{self.name}'


@dataclass(frozen=True)
class Run:
    """One input with one set of parameters.

    Attributes:
        number: from 1.
        values: of the axes, in their order.
        parameters: of each node to run; changes of the defaults.
        topic: of the images of a bag that has several.
    """

    number: int
    source: str
    values: tuple[Value, ...]
    parameters: Mapping[str, Mapping[str, Any]]
    topic: str | None = None


@dataclass(frozen=True)
class RunResult:
    """A run's numbers, or why it failed."""

    run: Run
    metrics: tuple[Metric, ...] = ()
    error: str = ''


def parse_axis(text: str) -> Axis:
    """Read ``node:name:=value,value,…``; one value is an axis of one.

    Raises:
        ParameterError: the form is another, the node or parameter is unknown, or a value of the
            list is not valid.
    """
    target, sign, values = text.partition(':=')
    parts = [part.strip() for part in values.split(',')]
    if not sign or not all(parts):
        raise ParameterError(
            text, 'write node:name:=value,value as in marker_tracker:search_radius:=4,6,8'
        )
    assignments = [parse_assignment(f'{target}:={part}') for part in parts]
    node, name, _ = assignments[0]
    if node not in PROCESSING_NODES:
        raise ParameterError(text, f'there are {", ".join(PROCESSING_NODES)}')
    spec = NODE_PARAMETERS[node].spec(name)
    return Axis(node, name, tuple(spec.convert(value) for _, _, value in assignments))


def plan_runs(
    sources: Sequence[str],
    axes: Sequence[Axis],
    base: Mapping[str, Mapping[str, Any]],
    topic: str | None = None,
) -> list[Run]:
    """Every combination of the axes' values, on every input.

    ``base`` is what differs from the defaults of each node to run.

    Raises:
        ParameterError: a parameter occurs twice, or its node is not to run.
    """
    for axis in axes:
        if axis.node not in base:
            raise ParameterError(axis.title, f'{axis.node} is not among {", ".join(base)}')
    titles = [axis.title for axis in axes]
    for title in titles:
        if titles.count(title) > 1:
            raise ParameterError(title, 'occurs twice; list its values in one --param')
    runs = []
    grid = itertools.product(sources, itertools.product(*(axis.values for axis in axes)))
    for number, (source, values) in enumerate(grid, 1):
        parameters = {node: dict(given) for node, given in base.items()}
        for axis, value in zip(axes, values, strict=True):
            parameters[axis.node][axis.name] = value
        runs.append(Run(number, source, values, parameters, topic))
    return runs


def do_run(run: Run) -> list[Metric]:
    """Replay one run's input and measure.

    Raises:
        SourceError, RecordingError, ParameterError: see `replay`.
    """
    return metrics_of(replay(run.source, run.parameters, run.topic))


def sweep(runs: Sequence[Run], jobs: int = 1, dask: str | None = None) -> Iterator[RunResult]:
    """Do the runs; one that fails is reported and does not stop the others.

    Args:
        runs: to do.
        jobs: processes on this machine.
        dask: a scheduler's address, such as ``tcp://10.0.0.1:8786``, instead.

    Yields:
        Results as they come, in any order.

    Raises:
        SourceError: Dask is not installed, or no scheduler answers.
    """
    done = _on_cluster(runs, dask) if dask else each(do_run, runs, jobs)
    for one in done:
        run = runs[one.number]
        if one.error is None:
            yield RunResult(run, tuple(one.result or ()))
        else:
            words = ' '.join(str(one.error).split())
            yield RunResult(run, error=words or type(one.error).__name__)


def _on_cluster(runs: Sequence[Run], address: str) -> Iterator[Done[list[Metric]]]:
    client, distributed = connect(address)
    with client:
        futures = {client.submit(do_run, run, pure=False): n for n, run in enumerate(runs)}
        with client.as_current():
            done = distributed.as_completed(list(futures))
        for future in done:
            problem = future.exception()
            result = None if problem else future.result()
            yield Done(futures[future], result, problem)


def in_order(results: Iterable[RunResult]) -> list[RunResult]:
    """By the runs' numbers."""
    return sorted(results, key=lambda result: result.run.number)

"""``mvuav replay``: the nodes over recordings, without a ROS graph."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from mvuav_ros.missing_module import explain_missing_module
from mvuav_ros.offline.replay.interruptions import (
    Terminated,
    ignore_signals,
    interrupt_on_signals,
)
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.parameters.parameter_file import parse_assignment, read_parameter_values
from mvuav_ros.recordings.sources.frame import SourceError
from mvuav_ros.recordings.sources.selection import Selection


def replay(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar='INPUT...', help='Bags, video files, or folders or globs of images.'
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            '--output',
            '-o',
            help='The bag to write, OUT.mcap; of several inputs the folder for their bags.',
            show_default=False,
        ),
    ],
    nodes: Annotated[str, typer.Option(help='Nodes to run, separated by commas.')] = (
        'marker_tracker,runway_detector'
    ),
    image_topic: Annotated[
        str | None, typer.Option(help='Image topic of a bag that has several.')
    ] = None,
    params_file: Annotated[
        Path | None, typer.Option(help='A ROS 2 parameter file.', show_default=False)
    ] = None,
    param: Annotated[
        list[str] | None,
        typer.Option(help='node:name:=value; may be repeated.', show_default=False),
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(
            help='Frame rate of images without stamps (folder: 30, video: its own).', min=0.001
        ),
    ] = None,
    start: Annotated[
        float, typer.Option(help='Begin so many seconds into the recording.', min=0.0)
    ] = 0.0,
    duration: Annotated[
        float | None, typer.Option(help='End so many seconds after the beginning.', min=0.0)
    ] = None,
    every: Annotated[
        int, typer.Option(help='Process only every so manieth frame.', metavar='N', min=1)
    ] = 1,
    keep_inputs: Annotated[
        bool,
        typer.Option('--keep-inputs', help="Also copy the input's topics; images as /image_raw."),
    ] = False,
    debug_images: Annotated[
        bool, typer.Option('--debug-images', help='Also write the debug images.')
    ] = False,
    gamma: Annotated[
        float,
        typer.Option(
            help='out = in ** gamma on every image (eq. 3.2), as video_source does; 1: off.',
            min=0.01,
            max=100.0,
        ),
    ] = 1.0,
    jobs: Annotated[int, typer.Option(help='Recordings to process at a time.', min=1)] = 1,
    dask: Annotated[
        str | None,
        typer.Option(help="Use a Dask cluster, by its scheduler's address.", metavar='tcp://…'),
    ] = None,
    strict: Annotated[
        bool, typer.Option('--strict', help='Exit with status 1 if anything was lost or refused.')
    ] = False,
    force: Annotated[bool, typer.Option('--force', help='Overwrite what is there.')] = False,
) -> None:
    """Run the nodes' own code over recordings and write their topics as mcap bags.

    The messages are those that the live nodes publish for the same images.

    With a folder as output, a recording that was finished before is not done again.
    """
    try:
        from mvuav_ros.cli.commands import replay_reports as reports
        from mvuav_ros.offline.replay.job import ReplaySettings
        from mvuav_ros.offline.replay.outputs import plan
    except ImportError as error:
        raise SourceError(explain_missing_module('replay', error)) from error

    settings = ReplaySettings(
        parameters=_parameters(nodes, params_file, param or []),
        image_topic=image_topic,
        fps=fps,
        selection=Selection(start, duration, every),
        keep_inputs=keep_inputs,
        debug_images=debug_images,
        gamma=gamma,
    )
    planned = plan(sources, output, settings, overwrite=force, absolute=dask is not None)
    with _told_when_interrupted():
        if dask is None and not planned[0].resume:
            outcomes = [reports.replay_one(planned[0])]
        else:
            outcomes = reports.replay_many(planned, jobs, dask)
    if any(outcome.error for outcome in outcomes):
        raise typer.Exit(1)
    if strict and any(outcome.lossy for outcome in outcomes):
        raise SourceError('--strict: something was lost or refused; see the warnings')


@contextmanager
def _told_when_interrupted() -> Iterator[None]:
    interrupt_on_signals()
    try:
        yield
    except KeyboardInterrupt as interruption:
        ignore_signals()
        typer.echo('mvuav: interrupted', err=True)
        terminated = isinstance(interruption, Terminated)
        raise typer.Exit(128 + (signal.SIGTERM if terminated else signal.SIGINT)) from None


def _parameters(
    nodes: str, params_file: Path | None, assignments: list[str]
) -> dict[str, dict[str, Any]]:
    """Every parameter of the nodes that the user named."""
    from mvuav_ros.processing.registry import PROCESSORS

    names = [name.strip() for name in nodes.split(',') if name.strip()]
    unknown = [name for name in names if name not in PROCESSORS]
    if unknown or not names:
        raise ParameterError(
            '--nodes', f'{", ".join(unknown) or "empty"}; there are {", ".join(PROCESSORS)}'
        )
    given: dict[str, dict[str, object]] = {
        name: read_parameter_values(params_file, name) if params_file else {} for name in names
    }
    for node, name, value in map(parse_assignment, assignments):
        if node not in given:
            raise ParameterError(f'{node}:{name}', f'{node} is not among --nodes {nodes}')
        given[node][name] = value
    parameters = {}
    for node, values in given.items():
        own = {name: value for name, value in values.items() if not _is_foreign(name)}
        parameters[node] = PROCESSORS[node].parameters_type.from_mapping(own).as_dict()
    return parameters


def _is_foreign(name: str) -> bool:
    """Parameters that every ROS node has, without a meaning for replay."""
    return name in ('use_sim_time', 'start_type_description_service') or name.startswith(
        'qos_overrides.'
    )

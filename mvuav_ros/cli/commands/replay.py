"""``mvuav replay``: the nodes over recordings, without a ROS graph."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from mvuav_ros.cli.storage import Storage
from mvuav_ros.missing_module import explain_missing_module
from mvuav_ros.offline.stopping import Interrupted, stop_on_signals
from mvuav_ros.recordings.sources.frame import SourceError
from mvuav_ros.recordings.sources.selection import Selection

Sources = Annotated[
    list[str],
    typer.Argument(
        metavar='INPUT...', help='Bags, videos, folders or globs of images; or their URLs.'
    ),
]
Output = Annotated[
    str,
    typer.Option(
        '--output',
        '-o',
        help='The bag to write, OUT.mcap; of several inputs the folder for their bags; or an URL.',
        show_default=False,
    ),
]
Nodes = Annotated[str, typer.Option(help='Nodes to run, separated by commas.')]
ImageTopic = Annotated[str | None, typer.Option(help='Image topic of a bag that has several.')]
ParamsFile = Annotated[
    Path | None, typer.Option(help='A ROS 2 parameter file.', show_default=False)
]
Param = Annotated[
    list[str] | None,
    typer.Option(help='node:name:=value; may be repeated.', show_default=False),
]
Fps = Annotated[
    float | None,
    typer.Option(
        help='Frame rate of images without stamps (folder: 30, video: its own).', min=0.001
    ),
]
Start = Annotated[float, typer.Option(help='Begin so many seconds into the recording.', min=0.0)]
Duration = Annotated[
    float | None, typer.Option(help='End so many seconds after the beginning.', min=0.0)
]
Every = Annotated[int, typer.Option(help='Process only every N-th frame.', metavar='N', min=1)]
KeepInputs = Annotated[
    bool,
    typer.Option('--keep-inputs', help="Also copy the input's topics; images as /image_raw."),
]
DebugImages = Annotated[bool, typer.Option('--debug-images', help='Also write the debug images.')]
Gamma = Annotated[
    float,
    typer.Option(
        help='out = in ** gamma on every image (eq. 3.2), as video_source does; 1: off.',
        min=0.01,
        max=100.0,
    ),
]
Format = Annotated[
    Storage, typer.Option('--format', help='mcap files, or rosbag2 folders with metadata.yaml.')
]
SplitMb = Annotated[
    int, typer.Option(help='MB after which a rosbag2 folder begins its next file.', min=0)
]
Jobs = Annotated[
    int | None,
    typer.Option(
        help='Processes that share the recordings, or one recording; all cores if left out.',
        min=1,
        show_default=False,
    ),
]
Dask = Annotated[
    str | None,
    typer.Option(help="Use a Dask cluster, by its scheduler's address.", metavar='tcp://…'),
]
Strict = Annotated[
    bool, typer.Option('--strict', help='Exit with status 1 if anything was lost or rejected.')
]
Force = Annotated[bool, typer.Option('--force', help='Overwrite what is there.')]


def replay(
    sources: Sources,
    output: Output,
    nodes: Nodes = 'marker_tracker,runway_detector',
    image_topic: ImageTopic = None,
    params_file: ParamsFile = None,
    param: Param = None,
    fps: Fps = None,
    start: Start = 0.0,
    duration: Duration = None,
    every: Every = 1,
    keep_inputs: KeepInputs = False,
    debug_images: DebugImages = False,
    gamma: Gamma = 1.0,
    storage: Format = Storage.MCAP,
    split_mb: SplitMb = 0,
    jobs: Jobs = None,
    dask: Dask = None,
    strict: Strict = False,
    force: Force = False,
) -> None:
    """Run the nodes' own code over recordings and write their topics as mcap bags.

    The messages are those that the live nodes publish for the same images.

    With a folder as output, manifest.json tells what became of each recording, and one that it
    says is finished is not done again.
    """
    try:
        from mvuav_ros.cli.commands import replay_reports as reports
        from mvuav_ros.offline.node_parameters import complete, node_names, resolve_parameters
        from mvuav_ros.offline.replay.job import ReplaySettings
        from mvuav_ros.offline.replay.outputs import plan
    except ImportError as error:
        raise SourceError(explain_missing_module('replay', error)) from error

    settings = ReplaySettings(
        parameters=complete(resolve_parameters(node_names(nodes), params_file, param or [])),
        image_topic=image_topic,
        fps=fps,
        selection=Selection(start, duration, every),
        keep_inputs=keep_inputs,
        debug_images=debug_images,
        gamma=gamma,
        split_bytes=storage.split_bytes(split_mb),
    )
    planned = plan(sources, output, settings, overwrite=force, absolute=dask is not None)
    processes = jobs or len(os.sched_getaffinity(0))
    with stop_on_signals() as stop:
        outcomes = reports.replay_all(planned, processes, dask, stop)
    if stop:
        raise Interrupted(stop.number)
    if any(outcome.failure for outcome in outcomes):
        raise typer.Exit(1)
    if strict and any(outcome.lossy for outcome in outcomes):
        raise SourceError('--strict: something was lost or rejected; see the warnings')

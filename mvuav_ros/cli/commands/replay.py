"""``mvuav replay``: the nodes over recordings, without a ROS graph."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Annotated, Any

import typer

from mvuav_ros.cli.options import (
    CameraInfo,
    Dask,
    Force,
    Format,
    ImageTopic,
    Param,
    ParamsFile,
    SplitMb,
    Storage,
    Strict,
    takes,
)
from mvuav_ros.detectors import DETECTORS
from mvuav_ros.offline.stopping import Interrupted, stop_on_signals
from mvuav_ros.sources.source import Selection, SourceError


@dataclass(frozen=True)
class ReplayOptions:
    """The options of ``mvuav replay``."""

    sources: Annotated[
        list[str],
        typer.Argument(
            metavar='INPUT...',
            help='Bags, videos, folders or globs of images, folders of them; or their URLs.',
        ),
    ]
    output: Annotated[
        str,
        typer.Option(
            '--output',
            '-o',
            help='The bag to write, OUT.mcap; with several inputs a folder for their bags; '
            'or a URL.',
            show_default=False,
        ),
    ]
    nodes: Annotated[str, typer.Option(help='Nodes to run, separated by commas.')] = ','.join(
        DETECTORS
    )
    image_topic: ImageTopic = None
    params_file: ParamsFile = None
    param: Param = None
    fps: Annotated[
        float | None,
        typer.Option(
            help='Frame rate of images without stamps (folder: 30, video: its own).', min=0.001
        ),
    ] = None
    start: Annotated[
        float, typer.Option(help='Start at this time of the recording, s.', min=0.0)
    ] = 0.0
    duration: Annotated[
        float | None, typer.Option(help='Length of the part to process, s.', min=0.0)
    ] = None
    every: Annotated[
        int, typer.Option(help='Process only every N-th frame.', metavar='N', min=1)
    ] = 1
    camera_info: CameraInfo = None
    image_is_rectified: Annotated[
        bool,
        typer.Option(
            '--image-is-rectified',
            help='The images are rectified: P of the calibration holds, without distortion.',
        ),
    ] = False
    keep_inputs: Annotated[
        bool,
        typer.Option('--keep-inputs', help="Also copy the input's topics; images as /image_raw."),
    ] = False
    debug_images: Annotated[
        bool, typer.Option('--debug-images', help='Also write the debug images.')
    ] = False
    gamma: Annotated[
        float,
        typer.Option(
            help='out = in ** gamma on every image (eq. 3.2), as video_source does; 1: off.',
            min=0.01,
            max=100.0,
        ),
    ] = 1.0
    storage: Format = Storage.MCAP
    split_mb: SplitMb = 0
    jobs: Annotated[
        int | None,
        typer.Option(
            help='Number of processes that share the work; default: one for each core.',
            min=1,
            show_default=False,
        ),
    ] = None
    dask: Dask = None
    strict: Strict = False
    force: Force = False


@takes(ReplayOptions)
def replay(options: ReplayOptions) -> dict[str, Any]:
    """Run the nodes' own code over recordings and write their topics as mcap bags.

    The messages are those that the live nodes publish for the same images.

    With a folder as output, manifest.json lists the outcome of each recording, and finished
    recordings are skipped.
    """
    from mvuav_ros.cli.commands import replay_reports as reports
    from mvuav_ros.offline.node_parameters import complete, node_names, resolve_parameters
    from mvuav_ros.offline.replay.job import ReplaySettings
    from mvuav_ros.offline.replay.outputs import plan
    from mvuav_ros.sources.calibration import load_calibration

    nodes = node_names(options.nodes)
    assignments = list(options.param or [])
    if options.image_is_rectified:
        assignments += [f'{node}:image_is_rectified:=true' for node in nodes]
    settings = ReplaySettings(
        parameters=complete(resolve_parameters(nodes, options.params_file, assignments)),
        image_topic=options.image_topic,
        fps=options.fps,
        selection=Selection(options.start, options.duration, options.every),
        keep_inputs=options.keep_inputs,
        debug_images=options.debug_images,
        gamma=options.gamma,
        camera=load_calibration(options.camera_info) if options.camera_info else None,
        split_bytes=options.storage.split_bytes(options.split_mb),
    )
    planned = plan(
        options.sources,
        options.output,
        settings,
        overwrite=options.force,
        absolute=options.dask is not None,
    )
    processes = options.jobs or len(os.sched_getaffinity(0))
    with stop_on_signals() as stop:
        outcomes = reports.replay_all(planned, processes, options.dask, stop)
    if stop:
        raise Interrupted(stop.number)
    if any(outcome.failure for outcome in outcomes):
        raise typer.Exit(1)
    if options.strict and any(outcome.lossy for outcome in outcomes):
        raise SourceError('--strict: something was lost or rejected; see the warnings')
    return {'recordings': [outcome.record() for outcome in outcomes]}

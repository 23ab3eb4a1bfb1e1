"""``mvuav simulate``: write a synthetic flight with its truth as a bag."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from mvuav_ros.cli.options import Force, parse_pair, refuse_to_overwrite, take_options
from mvuav_ros.cli.terminal import frame_progress, say
from mvuav_ros.offline.stopping import Interrupted, stop_on_signals
from mvuav_ros.parameters.declaration import ParameterSet
from mvuav_ros.recordings.account import counted
from mvuav_ros.simulation.settings import RunwaySettings, TankerSettings

simulate = typer.Typer(
    help='Write a synthetic flight: images, calibration and the truth.',
    no_args_is_help=True,
    rich_markup_mode=None,
)


def _command(kind: str, settings: type[ParameterSet]) -> Callable[..., None]:
    """A command with one option for each setting of the flight."""

    def run(
        output: Path = typer.Option(..., '--output', '-o', help='OUT.mcap.'),
        size: str = typer.Option('', help='WxH, instead of --width and --height.'),
        force: Force = False,
        **given: Any,
    ) -> None:
        if size:
            given['width'], given['height'] = parse_pair('--size', size, 'WxH, as in 640x480')
        _write(kind, given, output, force)

    options = {}
    for spec in settings.specs():
        limits = ', '.join(filter(None, (spec.unit, spec.constraint)))
        words = spec.description + (f' [{limits}]' if limits else '')
        options[spec.name] = Annotated[spec.type, typer.Option(help=words)], spec.default
    run.__doc__ = settings.__doc__
    take_options(run, options)
    return run


simulate.command('tanker')(_command('tanker', TankerSettings))
simulate.command('runway')(_command('runway', RunwaySettings))


def _write(kind: str, given: dict[str, object], output: Path, force: bool) -> None:
    from mvuav_ros.offline.frame_messages import frame_messages
    from mvuav_ros.recordings.writing import RecordingWriter
    from mvuav_ros.sources.opening import SimulatedFlight, make_flight

    flight = SimulatedFlight(f'sim:{kind}', make_flight(kind, given))
    refuse_to_overwrite(output, force)
    with (
        stop_on_signals() as stop,
        RecordingWriter(output, overwrite=force) as writer,
        frame_progress() as progress,
    ):
        for frame in progress.track(flight.frames(), total=flight.count, description=flight.name):
            for topic, type_name, make in frame_messages(frame):
                writer.write(topic, type_name, frame.stamp_ns, make())
            if stop:
                break
    if stop:
        raise Interrupted(stop.number)
    written = counted(flight.count or 0, 'frame')
    say(f'{output}: {written}, {output.stat().st_size / 1e6:.1f} MB')

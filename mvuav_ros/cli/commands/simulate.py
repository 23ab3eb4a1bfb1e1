"""``mvuav simulate``: write a synthetic flight with its truth as a bag."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from mvuav_ros.cli.progress import frame_progress
from mvuav_ros.missing_module import explain_missing_module
from mvuav_ros.offline.stopping import Interrupted, stop_on_signals
from mvuav_ros.parameters.declaration import ParameterError, ParameterSet
from mvuav_ros.recordings.errors import RecordingError
from mvuav_ros.recordings.sources.frame import SourceError
from mvuav_ros.recordings.sources.simulated import FRAME_ID, camera_model, make_flight
from mvuav_ros.recordings.writing import RecordingWriter
from mvuav_ros.simulation.flight import SimulatedFrame
from mvuav_ros.simulation.settings import RunwaySettings, TankerSettings

simulate = typer.Typer(
    help='Write a synthetic flight: images, calibration and the truth.',
    no_args_is_help=True,
    rich_markup_mode=None,
)


def _command(kind: str, settings: type[ParameterSet]) -> Callable[..., None]:
    """A command with one option for each setting of the flight."""

    def run(output: Path, size: str, force: bool, **given: Any) -> None:
        if size:
            given['width'], given['height'] = _parse_size(size)
        _write(kind, given, output, force)

    options = [
        ('output', Path, typer.Option('--output', '-o', help='OUT.mcap.'), inspect.Parameter.empty),
        ('size', str, typer.Option(help='WxH, instead of --width and --height.'), ''),
        ('force', bool, typer.Option('--force', help='Overwrite OUT.mcap.'), False),
    ]
    for spec in settings.specs():
        words = ', '.join(text for text in (spec.unit, spec.constraint) if text)
        option = typer.Option(help=f'{spec.description}{f" [{words}]" if words else ""}')
        options.append((spec.name, spec.type, option, spec.default))
    run.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [
            inspect.Parameter(
                name,
                inspect.Parameter.KEYWORD_ONLY,
                default=default,
                annotation=Annotated[annotation, option],
            )
            for name, annotation, option, default in options
        ]
    )
    # typer reads both.
    run.__annotations__ = {name: annotation for name, annotation, _, _ in options}
    run.__doc__ = settings.__doc__
    return run


simulate.command('tanker')(_command('tanker', TankerSettings))
simulate.command('runway')(_command('runway', RunwaySettings))


def _parse_size(text: str) -> tuple[int, int]:
    width, sign, height = text.lower().partition('x')
    if not (sign and width.isdigit() and height.isdigit()):
        raise ParameterError('--size', f'write WxH, as in 640x480, not {text!r}')
    return int(width), int(height)


def _write(kind: str, given: dict[str, object], output: Path, force: bool) -> None:
    try:
        from mvuav_ros.offline.simulate import truth_messages
    except ImportError as error:
        raise SourceError(explain_missing_module('simulate', error)) from error
    flight = make_flight(kind, given)
    if output.exists() and not force:
        raise RecordingError(f'{output} exists; --force overwrites it')
    camera = camera_model(flight.camera)
    seed = flight.settings.seed
    with (
        stop_on_signals() as stop,
        RecordingWriter(output, overwrite=force) as writer,
        frame_progress() as progress,
    ):
        frames: Iterable[SimulatedFrame[Any]] = flight
        for frame in progress.track(frames, total=len(flight), description=f'sim:{kind}'):
            for topic, type_name, data in truth_messages(frame, camera, FRAME_ID, seed):
                writer.write(topic, type_name, frame.stamp_ns, data)
            if stop:
                break
    if stop:
        raise Interrupted(stop.number)
    typer.echo(f'{output}: {len(flight)} frames, {output.stat().st_size / 1e6:.1f} MB')

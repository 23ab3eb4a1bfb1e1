"""``mvuav``: the subcommands, and how mistakes and interruptions end."""

from __future__ import annotations

import signal
import sys
from types import FrameType
from typing import Annotated, NoReturn

import typer

import mvuav_ros
from mvuav_ros.cli.commands.bench import bench
from mvuav_ros.cli.commands.demo import demo
from mvuav_ros.cli.commands.evaluate import evaluate
from mvuav_ros.cli.commands.export import export
from mvuav_ros.cli.commands.info import info
from mvuav_ros.cli.commands.repair import repair
from mvuav_ros.cli.commands.replay import replay
from mvuav_ros.cli.commands.rig import rig
from mvuav_ros.cli.commands.simulate import simulate
from mvuav_ros.cli.commands.sweep import sweep
from mvuav_ros.cli.typer_annotations import spell_unions_out
from mvuav_ros.missing_module import explain_missing_module
from mvuav_ros.offline.stopping import SIGNALS, Interrupted
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.recordings.errors import RecordingError
from mvuav_ros.recordings.sources.frame import SourceError

app = typer.Typer(
    name='mvuav',
    help="Machine vision for UAVs: a tanker's marker lights, a runway's lines.",
    no_args_is_help=True,
    rich_markup_mode=None,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command()(replay)
app.command()(info)
app.command()(repair)
app.command()(export)
app.command()(bench)
app.command()(demo)
app.command()(sweep)
app.add_typer(simulate, name='simulate')
app.add_typer(evaluate, name='evaluate')
app.add_typer(rig, name='rig')


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f'mvuav_ros {mvuav_ros.__version__}')
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option('--version', help='Show the version.', callback=_show_version, is_eager=True),
    ] = False,
) -> None:
    pass


spell_unions_out(app)


def main() -> NoReturn:
    """Run the command; a user's mistake is one line on stderr, never a traceback."""
    # Commands that leave files behind take the signals themselves, see `stop_on_signals`.
    for number in SIGNALS:
        signal.signal(number, _interrupt)
    try:
        status = app(prog_name='mvuav', standalone_mode=False)
        if status == 128 + signal.SIGINT:
            # What typer makes of a KeyboardInterrupt.
            _fail('interrupted', status)
    except (ParameterError, RecordingError, SourceError) as error:
        _fail(str(error), 1)
    except Interrupted as interruption:
        _fail('interrupted', 128 + interruption.number)
    except OSError as error:
        _fail(str(error), 1)
    except ImportError as error:
        # Commands import what they need when they are called.
        _fail(explain_missing_module(sys.argv[1], error), 1)
    except Exception as error:
        # Usage errors of typer, whose own click is not importable under a public name.
        if not hasattr(error, 'format_message'):
            if type(error).__name__ == 'Abort':
                _fail('interrupted', 128 + signal.SIGINT)
            raise
        _fail(f'{error.format_message()} (see mvuav --help)', 2)
    _leave(status if isinstance(status, int) else 0)


def _fail(message: str, status: int) -> NoReturn:
    print('mvuav: ' + ' '.join(message.split()), file=sys.stderr)
    _leave(status)


def _leave(status: int) -> NoReturn:
    # All is said and done: Ctrl-C from now on could only make a traceback.
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    sys.exit(status)


def _interrupt(number: int, _frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt if number == signal.SIGINT else Interrupted(number)


if __name__ == '__main__':
    main()

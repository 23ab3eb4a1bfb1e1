"""``mvuav``: the subcommands, and how mistakes and interruptions end."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterable
from importlib import import_module
from types import FrameType
from typing import Annotated, NoReturn

import typer

import mvuav_ros
from mvuav_ros.cli.accounting import account_for_inputs
from mvuav_ros.cli.terminal import say
from mvuav_ros.cli.typer_annotations import spell_unions_out
from mvuav_ros.missing_module import explain_missing_module
from mvuav_ros.offline.stopping import SIGNALS, Interrupted
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.recordings.recording import RecordingError
from mvuav_ros.sources.source import SourceError

COMMANDS = (
    'replay',
    'info',
    'repair',
    'export',
    'bench',
    'demo',
    'sweep',
    'simulate',
    'evaluate',
    'calibrate',
    'rig',
)
"""Each a module of `mvuav_ros.cli.commands` with a function or a group of that name."""


def application(names: Iterable[str] = COMMANDS) -> typer.Typer:
    """The command line with these commands; importing one takes longer than many a one's work."""
    app = typer.Typer(
        name='mvuav',
        help="Machine vision for UAVs: a tanker's marker lights, a runway's lines.",
        no_args_is_help=True,
        rich_markup_mode=None,
        add_completion=False,
        pretty_exceptions_enable=False,
    )
    app.callback()(_options)
    for name in names:
        command = getattr(import_module(f'mvuav_ros.cli.commands.{name}'), name)
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name)
        else:
            app.command(name)(command)
    account_for_inputs(app)
    spell_unions_out(app)
    return app


def _show_version(wanted: bool) -> None:
    if wanted:
        say(f'mvuav_ros {mvuav_ros.__version__}')
        raise typer.Exit


def _options(
    version: Annotated[
        bool,
        typer.Option('--version', help='Show the version.', callback=_show_version, is_eager=True),
    ] = False,
) -> None:
    pass


def main() -> NoReturn:
    """Run the command; a user's mistake is one line on stderr, never a traceback."""
    named = [name for name in sys.argv[1:2] if name in COMMANDS]
    interrupts: list[int] = []

    def interrupt(number: int, _frame: FrameType | None) -> NoReturn:
        interrupts.append(number)
        # After a KeyboardInterrupt in an exec() of text, as dataclasses are made, Python ends by
        # the signal and not with our status, even where it is caught.
        raise Interrupted(number)

    try:
        # Until all is imported the handlers of `mvuav_ros.__main__` stay.
        app = application(named or COMMANDS)
        # Commands that leave files behind take the signals themselves, see `stop_on_signals`.
        for number in SIGNALS:
            signal.signal(number, interrupt)
        status = app(prog_name='mvuav', standalone_mode=False)
    except Interrupted as interruption:
        _fail('interrupted', 128 + interruption.number)
    except Exception as error:
        if interrupts:
            # Commands import what they need when they are called, and an import that is
            # interrupted may end with an error of its own.
            _fail('interrupted', 128 + interrupts[0])
        _fail(*_explained(error, named[0] if named else 'mvuav'))
    _leave(status if isinstance(status, int) else 0)


def _explained(error: Exception, name: str) -> tuple[str, int]:
    """A user's mistake in words and as an exit status.

    Raises:
        Exception: the error, if it is a defect of ours.
    """
    if isinstance(error, (ParameterError, RecordingError, SourceError, OSError)):
        return str(error), 1
    if isinstance(error, ImportError):
        return explain_missing_module(name, error), 1
    # Usage errors of typer, whose own click is not importable under a public name.
    if hasattr(error, 'format_message'):
        return f'{error.format_message()} (see mvuav --help)', 2
    if type(error).__name__ == 'Abort':
        return 'interrupted', 128 + signal.SIGINT
    raise error


def _fail(message: str, status: int) -> NoReturn:
    say(f'mvuav: {" ".join(message.split())}', err=True)
    _leave(status)


def _leave(status: int) -> NoReturn:
    # All is said and done: Ctrl-C from now on could only make a traceback.
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    sys.exit(status)


if __name__ == '__main__':
    main()

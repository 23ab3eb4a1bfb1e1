"""``mvuav``: the subcommands, what their inputs lost, and how mistakes and interruptions end."""

from __future__ import annotations

import dataclasses
import inspect
import json
import os
import signal
import sys
from collections.abc import Callable, Iterable
from contextlib import nullcontext, redirect_stdout
from importlib import import_module
from io import StringIO
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, NoReturn
from urllib.parse import unquote

import typer

import mvuav_ros
from mvuav_ros.cli.options import AsJson, CommandFailedError, MaxSize, Strict, take_options
from mvuav_ros.cli.terminal import report_account, say
from mvuav_ros.missing_module import explain_missing_module
from mvuav_ros.offline.stopping import SIGNALS, Interrupted
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.recordings.account import Account, RecordingError, SourceError, collecting

_INPUTS = frozenset({'source', 'sources'})
"""Of a command that reads what others wrote."""
_ADDED = {'strict': (Strict, False), 'max_size': (MaxSize, None), 'as_json': (AsJson, False)}
"""What every such command takes, with the defaults."""
COMMANDS = {
    'replay': 'replay',
    'info': 'recording_tools',
    'repair': 'recording_tools',
    'export': 'recording_tools',
    'bench': 'bench',
    'demo': 'demo',
    'sweep': 'sweep',
    'simulate': 'simulate',
    'evaluate': 'evaluate',
    'calibrate': 'calibrate',
    'rig': 'calibrate',
}
"""The module of `mvuav_ros.cli.commands` that has a function or a group of that name."""


def account_for_inputs(app: typer.Typer) -> None:
    """Make every command of an application and its groups that has an input say what it lost.

    It does so on stderr, in ``--json``, and with ``--strict``, whatever the command does itself.
    """
    for command in app.registered_commands:
        if command.callback is not None:
            command.callback = _callback(command.callback)
    for group in app.registered_groups:
        if group.typer_instance is not None:
            account_for_inputs(group.typer_instance)


def _callback(work: Callable[..., Any]) -> Callable[..., Any]:
    """A command whose annotations are no texts: those typer 0.9, which apt has, does not read."""
    own = inspect.signature(work, eval_str=True).parameters
    added = {}
    if _INPUTS & own.keys():
        added = {name: each for name, each in _ADDED.items() if name not in own}

    def run(**given: Any) -> Any:
        ours = {name: given.pop(name) for name in added}
        given = {name: _named(value) for name, value in given.items()}
        return _account_for(work, given, **{**given, **ours}) if added else work(**given)

    run.__name__, run.__doc__ = work.__name__, work.__doc__
    take_options(run, added, work)
    return run


def _account_for(
    work: Callable[..., Any],
    given: dict[str, Any],
    strict: bool,
    max_size: int | None,
    as_json: bool,
    **_: Any,
) -> None:
    from mvuav_ros.recordings.compression import allowing

    result, ending = None, None
    with allowing(max_size), collecting() as accounts:
        # Words and numbers for people would be in the way of the machine that reads it.
        with redirect_stdout(StringIO()) if as_json else nullcontext():
            try:
                result = work(**given)
            except CommandFailedError as failed:
                result, ending = failed.result, failed.ending
            except Exception as error:
                ending = error
        inputs = _of_each_input(accounts)
        for account in inputs:
            is_over = ending is None or isinstance(ending, typer.Exit)
            if not account.is_reported and (is_over or account.is_lossy):
                report_account(account, account.name if len(inputs) > 1 else '')
    if as_json:
        said = result if isinstance(result, dict) else dataclasses.asdict(result) if result else {}
        said = {**said, 'accounts': [account.record() for account in inputs]}
        print(json.dumps(said, indent=2, default=str))
    if ending is not None:
        raise ending
    if strict and any(account.is_lossy for account in accounts):
        raise RecordingError('--strict: something was lost or altered; see above')


def _named(value: Any) -> Any:
    """An option's value; a place that a file:// URL or ~ names is its path, whoever looks at it."""
    if isinstance(value, list):
        return [_named(each) for each in value]
    if isinstance(value, Path):
        return Path(_named(str(value).replace('file:/', 'file:///', 1)))
    if not isinstance(value, str):
        return value
    if value.startswith('file://'):
        return unquote(value.removeprefix('file://'))
    # The shell leaves ~ as it is in --output=~/flight. A slash at the end is kept.
    return os.path.expanduser(value)  # noqa: PTH111


def _of_each_input(accounts: Iterable[Account]) -> list[Account]:
    """Of an input that was opened several times, the account that says most."""

    def says(account: Account) -> tuple[bool, int, int, int]:
        return account.is_reported, len(account.errors), len(account.warnings), account.kept

    best: dict[str, Account] = {}
    for account in accounts:
        best[account.input] = max(best.get(account.input, account), account, key=says)
    return [*best.values()]


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
    app.callback()(_callback(_options))
    for name in names:
        command = getattr(import_module(f'mvuav_ros.cli.commands.{COMMANDS[name]}'), name)
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name)
        else:
            app.command(name)(command)
    account_for_inputs(app)
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
    """A user's mistake in words and as an exit status; raises what is a defect of ours."""
    if isinstance(error, ImportError):
        return explain_missing_module(name, error), 1
    if isinstance(error, OSError):
        said = error.strerror or str(error)
        return f'{error.filename}: {said}' if error.filename else said, 1
    if isinstance(error, (ParameterError, SourceError)):
        return str(error), 1
    # Usage errors of typer, whose own click is not importable under a public name.
    if type(error).__name__ == 'NoArgsIsHelpError':
        say(*error.ctx.get_help().splitlines())  # type: ignore[attr-defined]
        _leave(2)
    if hasattr(error, 'format_message'):
        return f'{error.format_message()} (see {error.ctx.command_path} --help)', 2  # type: ignore[attr-defined]
    raise error


def _fail(message: str, status: int) -> NoReturn:
    say(f'mvuav: {" ".join(message.split())}', err=True)
    _leave(status)


def _leave(status: int) -> NoReturn:
    # All is said and done: Ctrl-C from now on could only make a traceback.
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    sys.exit(status)

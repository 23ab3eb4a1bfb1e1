"""Commands that say what their inputs lost: on stderr, in ``--json``, and with ``--strict``.

Every command that takes an input becomes one (`account_for_inputs`), whatever it does itself.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
from collections.abc import Callable, Iterable
from contextlib import nullcontext, redirect_stdout
from io import StringIO
from typing import Any, get_type_hints

import typer

from mvuav_ros.cli.options import AsJson, MaxSize, Strict
from mvuav_ros.cli.terminal import tell_account
from mvuav_ros.recordings.account import Account, collecting
from mvuav_ros.recordings.limits import allowing
from mvuav_ros.recordings.recording import RecordingError

_INPUTS = frozenset({'source', 'sources'})
"""Of a command that reads what others wrote."""
_OPTIONS = {'strict': (Strict, False), 'max_size': (MaxSize, None), 'as_json': (AsJson, False)}
"""What every such command takes, with the defaults."""


def account_for_inputs(app: typer.Typer) -> None:
    """Make every command of an application and its groups that has an input account for it."""
    for command in app.registered_commands:
        if command.callback and _INPUTS & inspect.signature(command.callback).parameters.keys():
            command.callback = _accounting(command.callback)
    for group in app.registered_groups:
        if group.typer_instance is not None:
            account_for_inputs(group.typer_instance)


def _accounting(work: Callable[..., Any]) -> Callable[..., None]:
    signature, hints = inspect.signature(work), get_type_hints(work, include_extras=True)
    added = {name: each for name, each in _OPTIONS.items() if name not in signature.parameters}

    def run(**given: Any) -> None:
        strict = given['strict']
        max_size = allowing(given['max_size'])
        as_json = bool('as_json' in added and given['as_json'])
        given = {name: value for name, value in given.items() if name not in added}
        with collecting() as accounts, max_size:
            # Words and numbers for people would be in the way of the machine that reads it.
            with redirect_stdout(StringIO()) if as_json else nullcontext():
                result, ending = _result(work, given)
            for account in accounts:
                if not account.is_told and (ending is None or isinstance(ending, typer.Exit)):
                    tell_account(account)
        if as_json:
            _print_json(result, accounts)
        if ending is not None:
            raise ending
        if strict and any(account.is_lossy for account in accounts):
            raise RecordingError('--strict: something was lost or altered; see above')

    parameters = [
        inspect.Parameter(
            name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation
        )
        for name, (annotation, default) in added.items()
    ]
    run.__name__, run.__doc__ = work.__name__, work.__doc__
    run.__annotations__ = {**hints, **{name: annotation for name, (annotation, _) in added.items()}}
    run.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[*signature.parameters.values(), *parameters]
    )
    return run


def _result(work: Callable[..., Any], given: dict[str, Any]) -> tuple[Any, Exception | None]:
    """What a command returns, and how it ends otherwise; an interruption passes."""
    try:
        return work(**given), None
    except Exception as error:
        return None, error


def _print_json(result: Any, accounts: Iterable[Account]) -> None:
    content = result if isinstance(result, dict) else dataclasses.asdict(result) if result else {}
    content = {**content, 'accounts': [account.record() for account in accounts]}
    print(json.dumps(content, indent=2, default=str))

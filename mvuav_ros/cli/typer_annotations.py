"""Annotations that typer 0.9 understands, which apt has on Ubuntu 24.04."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import typer


def spell_unions_out(app: typer.Typer) -> None:
    """Write ``X | None`` as ``Optional[X]`` in all commands of an application and its groups."""
    callbacks = [command.callback for command in app.registered_commands]
    if app.registered_callback is not None:
        callbacks.append(app.registered_callback.callback)
    for callback in filter(None, callbacks):
        hints = get_type_hints(callback, include_extras=True)
        _annotate(callback, {name: _spelt(hint) for name, hint in hints.items()})
    for group in app.registered_groups:
        if group.typer_instance is not None:
            spell_unions_out(group.typer_instance)


def _annotate(callback: Callable[..., Any], annotations: dict[str, Any]) -> None:
    """Both where typer looks."""
    signature = inspect.signature(callback)
    callback.__annotations__ = annotations
    callback.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[
            parameter.replace(annotation=annotations[name])
            for name, parameter in signature.parameters.items()
        ],
        return_annotation=None,
    )


def _spelt(hint: Any) -> Any:
    if get_origin(hint) is Annotated:
        inner, *extras = get_args(hint)
        return Annotated[(_spelt(inner), *extras)]
    return Union[get_args(hint)] if isinstance(hint, UnionType) else hint  # noqa: UP007

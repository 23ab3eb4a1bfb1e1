"""The page of the command line, from the commands' declarations."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import typer

from mvuav_ros.cli.app import application
from mvuav_ros.parameters.parameter_file import NODE_PARAMETERS

_KINDS = {str: 'text', Path: 'path', int: 'integer', float: 'number'}
_HEAD = """\
# Command line

<!-- made by tools/make_reference.py (make docs) from mvuav_ros/cli -->

## Exit status

| status | meaning |
|---|---|
| 0 | done; what was lost of a damaged recording is listed on stderr |
| 1 | failed, with one line that says why; with `--strict` also when anything was lost |
| 2 | the command line is wrong: an unknown option, or a value that is none of its type |
| 130, 143 | interrupted (Ctrl-C, SIGTERM); files are closed properly |

A mistake is one line on stderr, never a traceback.
"""
_INPUTS = """\
## Inputs

Where a command takes an `INPUT`, it accepts:

| input | example |
|---|---|
| rosbag2 folder, split or compressed, mcap or sqlite3 | `flight/` |
| bare file | `flight.mcap`, `flight.db3` |
| ROS 1 bag | `flight.bag` |
| video | `flight.mp4` |
| folder or glob of images | `frames/`, `'frames/*.png'` |
| URL, with the extra `remote` | `https://…/flight.mcap`, `s3://bucket/flight.mcap` |
| synthetic flight | `'sim:tanker?motion=roll&shake=2'`, `'sim:runway?frames=40'` |

The content decides what a file is, not its name. A synthetic flight takes the options of `mvuav simulate`, with `_` for `-`
(`start_distance=30`), and `width` and `height` for `--size`.
"""


def command_line_page() -> str:
    """The page."""
    parts = [_HEAD, _INPUTS]
    for name, command in _commands(typer.main.get_command(application()), 'mvuav'):
        parts.append(_command(name, command))
    parts.append(_nodes())
    return '\n'.join(parts)


def _commands(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    below = getattr(command, 'commands', None)
    if below is None:
        yield name, command
        return
    for word in sorted(below):
        yield from _commands(below[word], f'{name} {word}')


def _command(name: str, command: Any) -> str:
    arguments = [each for each in command.params if each.param_type_name == 'argument']
    usage = ' '.join([name, '[OPTIONS]', *map(_argument, arguments)])
    text = (command.help or '').split('\f')[0].strip()
    lines = [f'## {name}', '', f'`{usage}`', '', text, '']
    lines += ['| option | values | default | meaning |', '|---|---|---|---|']
    lines += [_row(each) for each in command.params]
    return '\n'.join(lines) + '\n'


def _argument(argument: Any) -> str:
    word = (argument.metavar or argument.name).upper().strip('{}')
    return f'{word}...' if argument.nargs == -1 and '...' not in word else word


def _row(parameter: Any) -> str:
    if parameter.param_type_name == 'argument':
        name = _argument(parameter)
    else:
        name = ', '.join([*parameter.opts, *parameter.secondary_opts])
    default = '' if parameter.required or parameter.default is None else _plain(parameter.default)
    if parameter.required:
        default = 'required'
    cells = (f'`{name}`', _values(parameter), default, _cell(parameter.help or ''))
    return '| ' + ' | '.join(cells) + ' |'


def _values(parameter: Any) -> str:
    kind = parameter.type_descriptor.annotation
    several = get_origin(kind) is list
    while get_args(kind) and get_origin(kind) is not Literal:
        kind = next(each for each in get_args(kind) if each is not type(None))
    if get_origin(kind) is Literal or issubclass(kind, Enum):
        choices = get_args(kind) or [each.value for each in kind]
        word = ', '.join(f'`{each}`' for each in choices)
    elif kind is bool:
        word = 'flag'
    else:
        word = _KINDS[kind]
    if parameter.metavar and parameter.param_type_name == 'option':
        word = f'`{parameter.metavar}`'
    if parameter.min is not None:
        top = f' to {parameter.max}' if parameter.max is not None else ' and more'
        word += f', {parameter.min}{top}'
    return word + (' (repeatable)' if several and parameter.param_type_name == 'option' else '')


def _plain(value: Any) -> str:
    if value is False or value in ((), [], ''):
        return ''
    return f'`{getattr(value, "value", value)}`'


def _cell(text: str) -> str:
    return ' '.join(text.split()).replace('|', '\\|')


def _nodes() -> str:
    names = ', '.join(f'`{name}`' for name in NODE_PARAMETERS)
    return f"""\
## Nodes

{names}, `vision_process` and `tuning_panel` are executables of the package: `ros2 run mvuav_ros NAME`, or
`.venv/bin/NAME` after `make .venv`. They take the arguments of ROS 2:

```text
marker_tracker --ros-args -p threshold:=0.6 -r image_raw:=/nose/image --params-file mine.yaml
```

A parameter that cannot be used ends the node with status 2 and one line that says why.
"""

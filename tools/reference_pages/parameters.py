"""``config/default.yaml`` and the page of parameters, from the parameter dataclasses."""

from __future__ import annotations

import re

from mvuav_ros.parameters.declaration import ParameterSpec, Value
from mvuav_ros.parameters.parameter_file import NODE_PARAMETERS

NODES = {name: NODE_PARAMETERS[name] for name in sorted(NODE_PARAMETERS)}
GENERATED = 'made by tools/make_reference.py (make docs) from mvuav_ros/parameters'

_INTRODUCTION = """\
Every parameter can be changed while the node runs, unless its description says otherwise. A change
takes effect between two frames. A value outside of the range is refused with the reason, and the
old value stays. The column *thesis* names the equation, appendix or GUI input that the parameter
comes from. [What the parameters do](../concepts/parameters-in-pictures.md) shows the important ones
on images; [File formats](file-formats.md#parameter-files) describes the files that hold them."""


def default_yaml() -> str:
    """A ROS 2 parameter file with every default, its unit and its range."""
    lines = [f'# Every default; {GENERATED}.']
    for node, parameters in NODES.items():
        lines += [f'/**/{node}:', '  ros__parameters:']
        for spec in parameters.specs():
            remark = ', '.join(text for text in (spec.unit, spec.constraint) if text)
            line = f'    {spec.name}: {_yaml(spec.default)}'
            lines.append(f'{line}  # {remark}' if remark else line)
    return '\n'.join(lines) + '\n'


def parameter_tables() -> str:
    """One table per node, in Markdown."""
    lines = [
        '---',
        'hide: [toc]',
        '---',
        '',
        '# Parameters',
        '',
        f'<!-- {GENERATED} -->',
        '',
        _INTRODUCTION,
        '',
    ]
    for node, parameters in NODES.items():
        lines += [f'## {node}', '', (parameters.__doc__ or '').splitlines()[0], '']
        lines += ['| parameter | default | values | meaning | thesis |', '|---' * 5 + '|']
        lines += [_row(spec) for spec in parameters.specs()]
        lines.append('')
    return '\n'.join(lines)


def _row(spec: ParameterSpec) -> str:
    meaning = spec.description + (' Set at the start only.' if spec.read_only else '')
    # Else `<image topic>` would be a tag.
    meaning = meaning.replace('<', '&lt;')
    values = ' '.join(text for text in (spec.constraint, spec.unit) if text)
    cells = (f'`{spec.name}`', f'`{_yaml(spec.default)}`', values, meaning, spec.thesis)
    return '| ' + ' | '.join(cells) + ' |'


def _yaml(value: Value) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return str(list(value))
    if isinstance(value, float):
        # Without a point YAML 1.1 takes 1e-07 for a text.
        return re.sub(r'^(-?\d+)e', r'\1.0e', str(value))
    return f"'{value}'" if isinstance(value, str) else str(value)

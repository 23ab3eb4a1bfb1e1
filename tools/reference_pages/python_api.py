"""The page of the public Python names, from their docstrings: readable as a plain file."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from importlib import import_module
from typing import Any

from mvuav_ros.parameters.declaration import ParameterSet

PARTS: dict[str, tuple[str, ...]] = {
    'From a recording to poses': (
        'processing.tracking.track',
        'processing.tracking.TrackedFrame',
        'processing.tracking.draw',
        'sources.opening.open_source',
        'messages.images.Frame',
        'messages.images.BadFrame',
    ),
    'Images, cameras and rigs': (
        'vision.image.Image',
        'vision.camera.CameraModel',
        'sources.calibration.load_calibration',
        'vision.rig.MarkerRig',
        'vision.rig.load_rig',
    ),
    'Markers and poses': (
        'vision.markers.tracker.MarkerTracker',
        'vision.markers.marker_results.MarkerResult',
        'vision.markers.marker_results.Marker',
        'vision.markers.marker_results.MarkerState',
        'vision.pose.PoseEstimator',
        'vision.pose.Pose',
    ),
    'Runways': (
        'vision.runway.detector.RunwayDetector',
        'vision.runway.results.RunwayResult',
        'vision.runway.results.RunwayLine',
        'vision.approach.approach_detector.ApproachDetector',
        'vision.frames.Attitude',
        'vision.approach.approach_results.ApproachResult',
        'vision.approach.approach_results.Guidance',
    ),
    'Parameters': (
        'parameters.parameter_file.load_parameters',
        'parameters.marker_tracker.MarkerTrackerParameters',
        'parameters.runway_detector.RunwayDetectorParameters',
    ),
    'Errors': (
        'sources.source.SourceError',
        'vision.camera.CalibrationError',
        'vision.image.ImageError',
        'vision.rig.RigError',
        'parameters.declaration.ParameterError',
    ),
}
_START = """\
# Python API

The names in **bold** can be imported from `mvuav_ros` itself; the others are what they take and give. Nothing here
needs ROS. Importing the package is cheap: each name is loaded when it is first used. Every example is run by the
tests, from the root of the repository.

Times are whole nanoseconds (`stamp_ns`), angles rad, lengths m, places on images px, with (0, 0) at the centre of the
top-left pixel. What is not known is NaN or None, with the reason in a `status`.
"""
_SECTIONS = ('Args', 'Returns', 'Yields', 'Raises', 'Attributes', 'Examples', 'Example')
_TITLES = {'Args': 'Takes', 'Returns': 'Gives', 'Yields': 'Yields', 'Attributes': 'Fields'}


def python_page() -> str:
    """The whole page."""
    import mvuav_ros

    lines = [_START]
    for title, names in PARTS.items():
        lines.append(f'## {title}\n')
        for place in names:
            module, _, name = place.rpartition('.')
            found = getattr(import_module(f'mvuav_ros.{module}'), name)
            is_public = name in mvuav_ros.__all__
            lines.append(f'### {"**" if is_public else ""}{name}{"**" if is_public else ""}\n')
            if not is_public:
                lines.append(f'In `mvuav_ros.{module}`.\n')
            lines += _described(name, found)
    return '\n'.join(lines).rstrip() + '\n'


def _described(name: str, found: Any) -> Iterator[str]:
    if inspect.isclass(found) and issubclass(found, Exception):
        yield f'{_plain(inspect.getdoc(found) or "")} A `{found.__mro__[1].__name__}`.\n'
        return
    is_set = inspect.isclass(found) and issubclass(found, ParameterSet)
    if is_set:
        yield f'{_plain(inspect.getdoc(found) or "")}\n'
        yield 'Its fields are the [parameters](parameters.md) of the node; wrong ones are refused.\n'
        return
    yield from _code(_signature(name, found))
    # None of object, which `inspect.getdoc` goes on to.
    initial = inspect.cleandoc(found.__init__.__doc__ or '') if 'process' in dir(found) else ''
    yield from _sections(inspect.getdoc(found) or '', found)
    if initial:
        yield from _sections(initial, found)
    if inspect.isclass(found):
        for member, value in vars(found).items():
            if not member.startswith('_') and (of := _member(value)) is not None:
                yield from _member_lines(f'{name}.{member}', of)


def _member(value: Any) -> Any:
    """What documents a method or a property; None of a field."""
    if isinstance(value, (classmethod, staticmethod)):
        return value.__func__
    return value if inspect.isfunction(value) or _is_property(value) else None


def _is_property(value: Any) -> bool:
    return isinstance(value, property) or type(value).__name__ == 'cached_property'


def _member_lines(name: str, value: Any) -> Iterator[str]:
    yield f'#### {name}\n'
    if not _is_property(value):
        yield from _code(_signature(name.rpartition('.')[2], value))
    yield from _sections(inspect.getdoc(value) or '', None)


def _signature(name: str, found: Any) -> str:
    if inspect.isclass(found) and issubclass(found, int):
        return '\n'.join(f'{name}.{each.name} = {int(each)}' for each in found)  # type: ignore
    if hasattr(found, '_fields'):
        given = list(found._fields)
    else:
        every = inspect.signature(found).parameters.values()
        parameters = [each for each in every if each.name not in ('self', 'cls')]
        given = [re.sub(r": '([^']*)'", r': \1', str(each)) for each in parameters]
        by_name = [each.kind is each.KEYWORD_ONLY for each in parameters]
        if any(by_name):
            given.insert(by_name.index(True), '*')
    short = f'{name}({", ".join(given)})'
    if len(short) <= 96:
        return short
    return f'{name}(\n' + ''.join(f'    {each},\n' for each in given) + ')'


def _code(text: str) -> Iterator[str]:
    yield f'```python\n{text}\n```\n'


def _sections(doc: str, found: Any) -> Iterator[str]:
    """A Google docstring as Markdown."""
    parts = re.split(rf'^({"|".join(_SECTIONS)}):\n', doc, flags=re.MULTILINE)
    yield _plain(parts[0]) + '\n'
    for title, body in zip(parts[1::2], parts[2::2], strict=True):
        # Behind an empty line, as the indentation of a first one does not count.
        text = inspect.cleandoc('\n' + body)
        if title.startswith('Example'):
            yield '```python\n' + text.rstrip() + '\n```\n'
        elif title in ('Returns', 'Yields'):
            yield f'{_TITLES[title]}: {_plain(text)}\n'
        else:
            yield f'{_TITLES.get(title, title)}:\n'
            yield from _items(text, found if title == 'Attributes' else None)
            yield ''


def _items(text: str, found: Any) -> Iterator[str]:
    kinds = {} if found is None else getattr(found, '__annotations__', {})
    for item in re.split(r'\n(?=\S)', text):
        name, _, words = item.partition(':')
        kind = kinds.get(name, '')
        kind = f' ({getattr(kind, "__forward_arg__", kind)})' if kind else ''
        said = _plain(inspect.cleandoc(words)).replace('\n', '\n  ')
        yield f'* `{name}`{kind}: {said}'


def _plain(text: str) -> str:
    """Paragraphs, each on its lines, with Markdown's quotes for code and no indentation."""
    text = text.replace('``', '`')
    return '\n'.join(line.strip() for line in text.strip().splitlines())

"""What nodes, bags, files and users say, made fit: the one door through which it comes in.

Whatever passes is text of bounded length that cannot break a line, a layout or a number. The page
shows it as text only and never puts it into markup, into an attribute that the browser acts on,
or into a string that NiceGUI parses (``props``, ``classes``, ``style``).
"""

from __future__ import annotations

import math
import os
import re
import stat
from collections.abc import Iterable, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from mvuav_ros.messages.untrusted import MAX_WORDS as LONGEST_WORDS
from mvuav_ros.messages.untrusted import words as words

LONGEST_DESCRIPTION = 2000
LONGEST_NAME = 255
"""Characters of a ROS name; DDS itself allows no more."""
_MAX_VALUES = 100
_MAX_STATUSES = 100
_MAX_NUMBERS = 16
"""Of one parameter; a user does not type more."""
_MAX_INTEGER = 2**63
"""Of a ROS parameter; a larger one does not fit a float either."""
_FILE_NAME = re.compile(r'[A-Za-z0-9][A-Za-z0-9 _.-]{0,63}', re.ASCII)
_ROS_NAME = re.compile(r'/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*')


def number(text: object) -> float:
    """The finite number that a text says; NaN where it says none."""
    try:
        value = float(str(text)[:LONGEST_WORDS])
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan


def fixed(text: object, digits: int) -> str:
    """A number with so many digits after the point; ``-`` where the text is no number."""
    value = number(text)
    if math.isnan(value):
        return '-'
    return f'{value:.{digits}f}' if abs(value) < 1e9 else f'{value:.{digits}e}'


def is_ros_name(text: str) -> bool:
    """Whether a node or topic can have this name; what else is announced was made to harm."""
    return len(text) <= LONGEST_NAME and _ROS_NAME.fullmatch(text) is not None


def key_values(pairs: Iterable[Any]) -> dict[str, str]:
    """Keys and values of a diagnostic status, diagnostic_msgs/KeyValue."""
    return {words(pair.key): words(pair.value) for pair in islice(pairs, _MAX_VALUES)}


def statuses(message: Any) -> dict[str, dict[str, str]]:
    """The statuses of a DiagnosticArray by name, each with its keys and values."""
    return {words(each.name): key_values(each.values) for each in message.status[:_MAX_STATUSES]}


def parameter_value(value: Any) -> Any:
    """A parameter's value: a scalar or a few numbers as they are, any other list as a line."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    items: Sequence[Any] = value
    if len(items) <= _MAX_NUMBERS and all(type(item) is float for item in items):
        return tuple(items)
    return words(', '.join(words(item) for item in items[:_MAX_VALUES]))


def plain_value(value: object) -> Any:
    """A parameter's value in a file: a scalar as it is, numbers as a tuple; None where neither."""
    numbers = value if isinstance(value, list) else [value]
    if any(isinstance(each, int) and abs(each) > _MAX_INTEGER for each in numbers):
        return None
    if isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, list) and all(type(number) in (int, float) for number in value):
        return tuple(map(float, value))
    return None


def file_text(path: Path, longest: int) -> str:
    """The text of a file of at most ``longest`` bytes.

    Raises:
        OSError: it is larger, is no file, or cannot be read.
        UnicodeDecodeError: it is no text.
    """
    # Opening a FIFO would wait for somebody to write into it, and reading a device never end.
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError('is not a regular file')
        content = os.read(descriptor, longest + 1)
    finally:
        os.close(descriptor)
    if len(content) > longest:
        raise OSError(f'has more than {longest} bytes')
    return content.decode()


class NameRefusedError(ValueError):
    """A name that cannot be given, with the reason."""


def checked_name(text: str) -> str:
    """The name, where it stays in its folder on every file system; NameRefusedError elsewhere."""
    name = text.strip()
    if not _FILE_NAME.fullmatch(name) or '..' in name or name.endswith('.'):
        raise NameRefusedError(
            'a name has letters, digits, spaces, - _ and single dots, begins with a letter or '
            'digit, and has at most 64 characters'
        )
    return name

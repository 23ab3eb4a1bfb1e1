"""Text that others wrote (topics, types, file names, messages), made fit to be shown.

A name in a file can clear a terminal, set its title, forge a line of a log, or turn the letters
behind it around. Whatever is printed, logged, or put into an error or a report comes through here.
"""

from __future__ import annotations

import unicodedata

MAX_WORDS = 200
MAX_LINE = 2000
_MAX_MARKS = 2
"""Combining marks on one letter; towers of them cover other lines."""
_UNKNOWN = '\N{REPLACEMENT CHARACTER}'


def visible(text: object, longest: int = MAX_LINE) -> str:
    r"""One line of visible characters, with its spaces, cut where it is too long.

    >>> visible('camera  \x1b[2J\u202egpj')
    'camera   [2Jgpj'
    """
    raw = str(text)
    if len(raw) > longest:
        raw = raw[: longest - 1] + '…'
    if raw.isascii() and raw.isprintable():
        return raw
    shown: list[str] = []
    marks = 0
    for letter in raw:
        category = unicodedata.category(letter)
        if letter.isspace() or category in ('Zl', 'Zp', 'Cc'):
            letter = ' '
        elif category == 'Cs':  # a byte of a file's name that is not UTF-8
            letter = _UNKNOWN
        elif category[0] == 'C':
            # Unseen: direction overrides, joiners, private use.
            continue
        marks = marks + 1 if category[0] == 'M' else 0
        if marks <= _MAX_MARKS:
            shown.append(letter)
    return ''.join(shown)


def words(text: object, longest: int = MAX_WORDS) -> str:
    r"""As `visible`, with single spaces: what stands within a sentence.

    >>> words(' a topic\n\tof  two lines')
    'a topic of two lines'
    """
    raw = str(text)
    line = ' '.join(visible(raw, 4 * longest).split())
    if len(line) > longest or len(raw) > 4 * longest:
        return line[: longest - 1].rstrip('… ') + '…'
    return line


class MalformedMessageError(ValueError):
    """A message whose bytes are not what its type asks for; one visible line."""

    def __init__(self, text: object) -> None:
        super().__init__(words(text, MAX_LINE))

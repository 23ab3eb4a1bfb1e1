"""Names that a user gives to sets and runs, which become file names."""

from __future__ import annotations

import re

_NAME = re.compile(r'[A-Za-z0-9][A-Za-z0-9 _.-]{0,63}', re.ASCII)


class NameRefusedError(ValueError):
    """A name that cannot be given, with the reason."""


def checked_name(text: str) -> str:
    """The name, where it is one that stays in its folder on every file system.

    Raises:
        NameRefusedError: it is not.
    """
    name = text.strip()
    if not _NAME.fullmatch(name) or '..' in name or name.endswith('.'):
        raise NameRefusedError(
            'a name has letters, digits, spaces, - _ and single dots, begins with a letter or '
            'digit, and has at most 64 characters'
        )
    return name

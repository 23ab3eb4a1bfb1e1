"""Whether a run printed what a page shows: words exactly, numbers within a tolerance."""

from __future__ import annotations

import re

ELLIPSIS = '…'
"""A line of its own stands for any lines, also none; within a line for any text."""
RELATIVE_TOLERANCE = 0.02
EXACT_BELOW = 10
"""Whole numbers below this are counts and must be equal."""
_NUMBER = re.compile(r'(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?!\w|\.\w)')
"""A number that is no part of a word, as ``mono8``, ``640x480`` and ``flight_1.mcap`` are."""


def difference(shown: str, printed: str) -> str:
    """Compare an output block of a page with what was printed.

    Returns:
        The first lines that do not fit, as a message; empty when all fits.
    """
    lines = [line for line in printed.splitlines() if line.strip()]
    parts = _parts_between_ellipses(shown)
    at = 0
    for number, part in enumerate(parts):
        begins = [at] if number == 0 else range(at, len(lines) - len(part) + 1)
        if number > 0 and number == len(parts) - 1:
            begins = [max(at, len(lines) - len(part))]
        begin = next((begin for begin in begins if _fits(part, lines, begin)), None)
        if begin is None:
            return _message(part, lines[at:])
        at = begin + len(part)
    if at < len(lines):
        return f'printed, but not shown:\n{lines[at]}'
    return ''


def same_line(shown: str, printed: str) -> bool:
    """Whether one printed line fits a shown one; runs of blanks count as one."""
    numbers = _NUMBER.findall(shown)
    pattern = ''.join(
        rf'({_NUMBER.pattern})' if _NUMBER.fullmatch(token) else _words(token)
        for token in re.split(f'({_NUMBER.pattern})', shown.strip())
        if token
    )
    found = re.fullmatch(pattern, printed.strip())
    return bool(found) and all(map(_close, numbers, found.groups()))


def _parts_between_ellipses(shown: str) -> list[list[str]]:
    parts: list[list[str]] = [[]]
    for line in shown.splitlines():
        if line.strip() == ELLIPSIS:
            parts.append([])
        elif line.strip():
            parts[-1].append(line)
    return parts


def _fits(part: list[str], lines: list[str], begin: int) -> bool:
    here = lines[begin : begin + len(part)]
    return len(here) == len(part) and all(map(same_line, part, here))


def _message(part: list[str], lines: list[str]) -> str:
    missing = [line for line in part if not any(same_line(line, other) for other in lines)]
    return 'shown, but not printed in this order:\n' + '\n'.join(missing or part)


def _words(text: str) -> str:
    pattern = r'\s+'.join(re.escape(word) for word in re.split(r'\s+', text))
    return pattern.replace(ELLIPSIS, '.*?')


def _close(shown: str, printed: str) -> bool:
    if shown.lstrip('-+').isdigit() and abs(int(shown)) < EXACT_BELOW:
        return float(printed) == int(shown)
    mantissa, _, exponent = shown.partition('e')
    last_digit = 10.0 ** (int(exponent or 0) - len(mantissa.partition('.')[2]))
    tolerance = max(RELATIVE_TOLERANCE * abs(float(shown)), last_digit)
    return abs(float(printed) - float(shown)) <= tolerance * (1 + 1e-9)

"""Checks the documentation's prose: short sentences, plain words, no riddles.

Usage: check_prose.py [FILE...]. The rules are few and are about what a reader of technical English
stumbles over; docs/decisions/prose-rules.md says why they are our own.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGES = ('README.md', 'CONTRIBUTING.md', 'docs/**/*.md')
DETAILED = {'docs/markers.md', 'docs/runway.md', 'docs/thesis.md', 'docs/evaluation.md'}
"""Measurements in full: sentences there may be longer."""
MOST_WORDS, MOST_WORDS_DETAILED = 34, 60
WORDS = {
    r'is said as': 'is',
    r'are said as': 'are',
    r'what was not found is said': 'missing values are NaN',
    r'to the letter': 'exactly',
    r'is told from': 'is distinguished from',
    r'as ever\b': 'as always, or leave it out',
    r'by and by': 'gradually',
    r'for ever\b': 'forever',
    r'manieth': 'nth',
    r'\bto and fro\b': 'back and forth',
    r'\butili[sz]e': 'use',
    r'\bin order to\b': 'to',
    r'\bsimply\b': 'leave it out',
    r'\bobviously\b': 'leave it out',
    r'\bof course\b': 'leave it out',
    r'\bplease note\b': 'leave it out',
    r'\bvery unique\b': 'unique',
    r'\be\.g\.|\bi\.e\.': 'for example, that is',
    r'\bleverag': 'use',
    r'\bseamless': 'leave it out',
    r'\bthus\b.*\bthus\b': 'one thus in a sentence',
    r'\b(?!CODE\b)([A-Za-z]+) \1\b(?<!that that)(?<!had had)': 'a word that stands twice',
}
_FENCE = re.compile(r'^( *)```.*?^\1```', re.M | re.S)
_COMMENT = re.compile(r'<!--.*?-->', re.S)
_LINK = re.compile(r'!?\[([^]]*)\]\([^)]*\)')
_CODE = re.compile(r'`[^`]*`')
_END = re.compile(r'(?<=[.!?:;])\s+')


def problems(text: str, most: int = MOST_WORDS) -> Iterator[tuple[int, str]]:
    """Line numbers and what is wrong there."""
    for line, paragraph in paragraphs(text):
        for rule, instead in WORDS.items():
            for found in re.finditer(rule, paragraph, re.I):
                yield line, f'"{found[0]}": {instead}'
        if paragraph.startswith('|'):
            continue
        for sentence in _END.split(paragraph):
            words = len(sentence.split())
            if words > most:
                yield line, f'a sentence of {words} words (at most {most}): {sentence[:60]}…'


def paragraphs(text: str) -> Iterator[tuple[int, str]]:
    """Paragraphs, items and table rows as one line each, without code; with their first line."""

    def blank(found: re.Match[str]) -> str:
        return '\n' * found[0].count('\n')

    text = _COMMENT.sub(blank, _FENCE.sub(blank, text))
    start, lines = 0, list[str]()
    for number, raw in enumerate([*text.splitlines(), ''], 1):
        line = raw.strip()
        begins = bool(re.match(r'([*+-]|\d+\.|#+|\||>|!!!) ?', line))
        if lines and (not line or begins):
            yield start, _plain(' '.join(lines))
            lines = []
        if (line and raw[:4] != '    ') or line:
            start = start if lines else number
            lines.append(line)


def _plain(text: str) -> str:
    return _CODE.sub('CODE', _LINK.sub(r'\1', text))


def main(names: Sequence[str] = ()) -> int:
    """Check the files named, or all pages."""
    given = [Path(name).resolve() for name in names]
    files = given or sorted(path for pattern in PAGES for path in ROOT.glob(pattern))
    count = 0
    for path in files:
        name = str(path.relative_to(ROOT)) if path.is_relative_to(ROOT) else str(path)
        most = MOST_WORDS_DETAILED if name in DETAILED else MOST_WORDS
        for line, problem in problems(path.read_text(encoding='utf-8'), most):
            print(f'{name}:{line}: {problem}')
            count += 1
    return 1 if count else 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))

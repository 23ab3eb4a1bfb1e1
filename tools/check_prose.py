"""Checks the prose of pages, docstrings and comments: short sentences, plain words, no riddles.

Usage: check_prose.py [FILE...]. The rules are few and are about what a reader of technical English
stumbles over; docs/decisions/prose-rules.md says why they are our own. Names in the package are
held to the field's words as well.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGES = ('README.md', 'CONTRIBUTING.md', 'docs/**/*.md')
DETAILED = {'docs/markers.md', 'docs/runway.md', 'docs/thesis.md', 'docs/evaluation.md'}
"""Measurements in full: sentences there may be longer."""
MAX_WORDS, MAX_WORDS_DETAILED = 34, 60
SOURCES = ('mvuav_ros/**/*.py', 'mvuav_thesis/**/*.py')
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
DIALECT = {
    r'\bupsets?\b': 'disturbed, inconsistent',
    r'\bsurpris(?:e|es|ed|ing)\b': 'normalized innovation squared, unexpected',
    r'\b(?:un)?contest(?:s|ed)?\b': 'ambiguous, in doubt',
    r'\bacquit(?:s|ted)?\b': 'confirm, clear',
    r'\b(?:fore)?(?:tells?|told|telling)\b': 'predict, distinguish, report',
    r'\bunrest\b': 'process noise, variance',
    r'\bliveliest\b': 'of the largest variance',
    r'\bforeign\b': 'untrusted, of others',
    r'\bstrangers?\b': 'clutter',
}
"""Of docstrings and comments: words of our own where the field has one."""
NAMES = {
    r'(?:^|_)(?:upset|surpris\w*?|contest\w*?|acquit\w*?)(?:_|$)': 'see the words of comments',
    # But for tell(), which is a stream's.
    r'(?!tell$)(?:^|_)(?:fore)?(?:tells?|told|telling)(?:_|$)': 'see the words of comments',
    r'(?:^|_)(?:unrest|liveliest|foreign|strangers?)(?:_|$)': 'see the words of comments',
    r'^Companions?$': 'SynchronizedTopic',
    r'^ReplayAhead$': 'ParallelReplay',
    r'^_hear$|^_give$': 'receive, dispatch',
    r'^all_as$': 'say what it does',
    r'^_?(?:MOST|FEWEST|LEAST|USUAL)(?:_|$)': 'MAX_, MIN_, TYPICAL_',
}
"""Of identifiers in the package."""
_FENCE = re.compile(r'^( *)```.*?^\1```', re.M | re.S)
_COMMENT = re.compile(r'<!--.*?-->', re.S)
_LINK = re.compile(r'!?\[([^]]*)\]\([^)]*\)')
_CODE = re.compile(r'`[^`]*`')
_END = re.compile(r'(?<=[.!?:;])\s+')


def problems(
    text: str, most: int = MAX_WORDS, rules: Mapping[str, str] = WORDS
) -> Iterator[tuple[int, str]]:
    """Line numbers and what is wrong there."""
    for line, paragraph in paragraphs(text):
        for rule, instead in rules.items():
            for found in re.finditer(rule, paragraph, re.I):
                yield line, f'"{found[0]}": {instead}'
        if paragraph.startswith('|'):
            continue
        for sentence in _END.split(paragraph):
            words = len(sentence.split())
            if words > most:
                yield line, f'a sentence of {words} words (at most {most}): {sentence[:60]}…'


def source_problems(source: str) -> Iterator[tuple[int, str]]:
    """The same of a module: its docstrings, its comments, and its names."""
    rules = WORDS | DIALECT
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Expr(value=ast.Constant(value=str(text))):
                for line, problem in problems(_without_examples(text), MAX_WORDS_DETAILED, rules):
                    yield node.lineno + line - 1, problem
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            comment = token.string.lstrip('#: ')
            for _, problem in problems(comment, MAX_WORDS_DETAILED, rules):
                yield token.start[0], problem
        elif token.type == tokenize.NAME:
            for rule, instead in NAMES.items():
                if re.search(rule, token.string):
                    yield token.start[0], f'the name {token.string}: {instead}'


def _without_examples(docstring: str) -> str:
    lines = docstring.splitlines()
    return '\n'.join('' if line.lstrip().startswith(('>>>', '...')) else line for line in lines)


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
    """Check the files named, or all pages and the package."""
    given = [Path(name).resolve() for name in names]
    found = (path for pattern in (*PAGES, *SOURCES) for path in ROOT.glob(pattern))
    files = given or sorted(path for path in found if 'build' not in path.relative_to(ROOT).parts)
    count = 0
    for path in files:
        name = str(path.relative_to(ROOT)) if path.is_relative_to(ROOT) else str(path)
        text = path.read_text(encoding='utf-8')
        most = MAX_WORDS_DETAILED if name in DETAILED else MAX_WORDS
        found = source_problems(text) if path.suffix == '.py' else problems(text, most)
        for line, problem in found:
            print(f'{name}:{line}: {problem}')
            count += 1
    return 1 if count else 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))

"""The code blocks of a page of the documentation, and how they are run."""

from __future__ import annotations

import contextlib
import io
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from support.places import ROOT

NOT_RUN = '*Not run by the tests:'
"""How the line above a block begins that is shown only; the reason follows."""
_FENCE = re.compile(
    r'^(?P<indent> *)```(?P<kind>\w*)[^\n]*\n(?P<text>.*?)^(?P=indent)```', re.M | re.S
)


@dataclass(frozen=True)
class Block:
    """A fenced block.

    Attributes:
        kind: ``bash``, ``python``, ``text`` …
        text: without the fence's indentation.
        line: of the fence in its page.
        reason: why it is not run; empty when it is.
    """

    kind: str
    text: str
    line: int
    reason: str = ''


def blocks_of(page: str) -> list[Block]:
    """All fenced blocks of a page, in order."""
    blocks = []
    for fence in _FENCE.finditer(page):
        before = page[: fence.start()].rstrip().rpartition('\n')[2].strip()
        reason = before.removeprefix(NOT_RUN).strip(' *') if before.startswith(NOT_RUN) else ''
        indent = len(fence['indent'])
        text = ''.join(line[indent:] for line in fence['text'].splitlines(keepends=True))
        line = page.count('\n', 0, fence.start()) + 1
        blocks.append(Block(fence['kind'], text, line, reason))
    return blocks


class TutorialRun:
    """One reader who follows a page, block by block, in a folder that looks like the repository."""

    def __init__(self, folder: Path, domain_id: int) -> None:
        """Prepare the folder: the repository's files, an empty ``out/tutorial``."""
        for name in ('bags', 'config', 'examples', 'test', 'launch'):
            (folder / name).symlink_to(ROOT / name)
        (folder / 'out' / 'tutorial').mkdir(parents=True)
        self.folder = folder
        path = f'{Path(sys.executable).parent}:{os.environ["PATH"]}'
        self.environment = {
            **os.environ,
            'PATH': path,
            'MPLBACKEND': 'Agg',
            'COLUMNS': '100',
            'ROS_DOMAIN_ID': str(domain_id),
        }
        self._names: dict[str, Any] = {'__name__': '__main__'}

    def run(self, block: Block) -> str:
        """Run a block; a bash block stops at its first failure.

        Returns:
            What it printed.
        """
        if block.kind == 'bash':
            return self._bash(block)
        return self._python(block)

    def _bash(self, block: Block) -> str:
        done = subprocess.run(
            ['bash', '-euo', 'pipefail', '-c', block.text],
            cwd=self.folder,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=500,
        )
        assert done.returncode == 0, f'line {block.line}:\n{block.text}\n{done.stdout}'
        return done.stdout

    def _python(self, block: Block) -> str:
        printed = io.StringIO()
        code = compile(block.text, f'block at line {block.line}', 'exec')
        with contextlib.redirect_stdout(printed), contextlib.chdir(self.folder):
            exec(code, self._names)
        return printed.getvalue()


def missing_lines(shown: str, printed: str) -> Iterator[str]:
    """Lines of a page's output block that the run did not print; numbers may differ."""
    found = {_shape(line) for line in printed.splitlines()}
    for line in shown.splitlines():
        if line.strip() and line.strip() != '…' and _shape(line) not in found:
            yield line


def _shape(line: str) -> str:
    return ' '.join(re.sub(r'[-+]?\d+(\.\d+)?(e[-+]?\d+)?|nan', '#', line).split())

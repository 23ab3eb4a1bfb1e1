"""The code blocks of a page of the documentation, and how they are run."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

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
    """One reader who follows a page, block by block, in a folder that looks like the repository.

    Shell blocks run in a new shell each. Python blocks are pasted into one plain ``python -i``.
    """

    def __init__(self, folder: Path, domain_id: int, *, prepared: bool = True) -> None:
        """Prepare the folder: the repository's files, and ``out/tutorial`` when prepared."""
        for name in ('bags', 'config', 'examples', 'test', 'tools', 'launch'):
            (folder / name).symlink_to(ROOT / name)
        if prepared:
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
        self._session: PythonSession | None = None

    def __enter__(self) -> TutorialRun:
        """Begin to read."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the Python session."""
        if self._session:
            self._session.close()

    def run(self, block: Block) -> str:
        """Run a block; it stops at its first failure.

        Returns:
            What it printed.

        Raises:
            AssertionError: if it failed.
        """
        if block.kind == 'bash':
            return self._bash(block)
        self._session = self._session or PythonSession(self.folder, self.environment)
        return self._session.paste(block)

    def _bash(self, block: Block) -> str:
        # What a block leaves running in the background would keep a pipe open.
        with tempfile.TemporaryFile('w+') as printed:
            process = subprocess.Popen(
                ['bash', '-euo', 'pipefail', '-c', block.text],
                cwd=self.folder,
                env=self.environment,
                stdout=printed,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            try:
                status = process.wait(LONGEST_BLOCK)
            finally:
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
            printed.seek(0)
            text = printed.read()
        assert status == 0, f'line {block.line}:\n{block.text}\n{text}'
        return text


class PythonSession:
    """An interactive Python without prompts, into which blocks are pasted."""

    def __init__(self, folder: Path, environment: dict[str, str]) -> None:
        """Start it in a folder."""
        self._process = subprocess.Popen(
            [sys.executable, '-i', '-q', '-u'],
            cwd=folder,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self._paste(_WITHOUT_PROMPTS)

    def paste(self, block: Block) -> str:
        """Paste a block and press Enter; returns what was printed."""
        timer = threading.Timer(LONGEST_BLOCK, self._process.kill)
        timer.start()
        try:
            printed, ended = self._paste(block.text)
        finally:
            timer.cancel()
        assert ended, f'line {block.line}:\n{block.text}\n{printed}'
        return printed

    def close(self) -> None:
        """End it."""
        self._process.kill()
        self._process.communicate()

    def _paste(self, text: str) -> tuple[str, bool]:
        assert self._process.stdin and self._process.stdout
        self._process.stdin.write(f'{text}\nprint({_END!r})\n')
        self._process.stdin.flush()
        printed = ''
        for line in self._process.stdout:
            if line.endswith(f'{_END}\n'):
                return printed + line.removesuffix(f'{_END}\n'), True
            printed += line
        return printed, False


LONGEST_BLOCK = 240
"""Seconds after which a block is taken to hang."""
_END = '--- end of block ---'
_WITHOUT_PROMPTS = '''exec("""
import os, sys, traceback
sys.ps1 = sys.ps2 = ''
def stop(*error):
    traceback.print_exception(*error)
    os._exit(1)
sys.excepthook = stop
""", {})'''

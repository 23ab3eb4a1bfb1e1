"""What became of a recording's messages: how many were kept, lost or altered, and why.

Whoever reads a recording fills its account; `collecting` finds all of them for the user.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from mvuav_ros.messages.untrusted import MAX_LINE, words
from mvuav_ros.missing_module import explain_missing_module

_MAX_TEXTS = 200
_MAX_ENTRIES = 10_000
_ALTERED = ('altered',)
"""In place of a file."""
_collected: ContextVar[list[Account] | None] = ContextVar('accounts', default=None)


class SourceError(Exception):
    """A source that cannot be opened or read, with what the user can do about it; one line."""

    def __init__(self, text: object) -> None:
        super().__init__(words(text, MAX_LINE))


class RecordingError(SourceError):
    """A recording that cannot be read or written."""


@contextmanager
def needed_for(what: str) -> Iterator[None]:
    """Around imports of what need not be installed: a RecordingError says how to install it."""
    try:
        yield
    except ImportError as error:
        raise RecordingError(explain_missing_module(what, error)) from error


class Account:
    """The account of one input; the same again (in a second pass) changes nothing.

    Attributes:
        name: of the input, for people.
        input: its name in full, which distinguishes it from others.
        kept: messages (of a video or a folder: frames) that the newest pass handed on.
        skipped: messages of topics that cannot be read, as they are not ROS's.
        is_reported: whether somebody has shown it.
    """

    def __init__(self, name: object = '') -> None:
        self.name = words(name)
        self.input = str(name)
        self.kept = 0
        self.skipped = 0
        self.is_reported = False
        # What was said under a file and a key, and of how many messages.
        self._entries: dict[tuple[Hashable, Hashable], tuple[str, int | None]] = {}
        self._notes: dict[Hashable, str] = {}
        self._left_out: dict[int, str] = {}
        self._missing: dict[Hashable, int] = {}
        self._promised: dict[Hashable, int] = {}
        self._is_full = False
        if (accounts := _collected.get()) is not None:
            accounts.append(self)

    def lose(self, file: Hashable, key: Hashable, text: str, count: int | None = None) -> None:
        """Say what could not be read, replacing what was said under the same file and key.

        ``count`` is the number of messages: None if nobody knows, 0 if there are none.
        """
        if (file, key) in self._entries or len(self._entries) < _MAX_ENTRIES:
            self._entries[file, key] = words(text, MAX_LINE), count
        else:
            self._is_full = True

    def alter(self, key: Hashable, text: str, count: int) -> None:
        """Say what was written otherwise than it was read."""
        self.lose(_ALTERED, key, text, count)

    def note(self, key: Hashable, text: str) -> None:
        """Say what is unusual, though nothing is lost by it."""
        if len(self._notes) < _MAX_TEXTS:
            self._notes[key] = words(text, MAX_LINE)

    def leave_out(self, stamp_ns: int, reason: str) -> None:
        """Say that the image of a stamp (ns) cannot be used."""
        self._left_out.setdefault(stamp_ns, reason)
        first = next(iter(self._left_out.values()))
        self.note('left out', f'{counted(len(self._left_out), "image")} left out: {first}')

    def promise(self, file: Hashable, written: int) -> None:
        """Take what a list of files says of one, which counts where that has no index itself."""
        self._promised[file] = written

    def promised(self, files: Iterable[Hashable]) -> int | None:
        """How many messages a list of files says that these have; None if not of all."""
        counts = [self._promised.get(file) for file in files]
        return None if None in counts else sum(count or 0 for count in counts)

    def settle(self, file: Hashable, written: int | None, sound: int) -> None:
        """Balance a file that was read to its end: what is missing without a reason is a loss, too.

        ``written`` are the messages that its index speaks of, None without an index; ``sound``
        those that were there and whole, wanted or not.
        """
        written = self._promised.get(file) if written is None else written
        self._missing.pop(file, None)
        if written is None:
            return
        missing = written - sound
        if missing < 0:
            said = f'{file}: its index speaks of {written} messages, {sound} are there'
            self.note((file, 'more'), said)
            return
        self._missing[file] = missing
        if missing > self._messages(lambda of: of == file):
            self.lose(file, 'rest', f'{file}: {missing} of {written} messages lost', 0)

    @property
    def lost(self) -> int:
        """Messages that are known to be lost."""
        known = self._messages(lambda file: file != _ALTERED and file not in self._missing)
        return known + sum(self._missing.values())

    @property
    def altered(self) -> int:
        """Messages that were written otherwise than they were read."""
        return self._messages(lambda file: file == _ALTERED)

    @property
    def is_exact(self) -> bool:
        """Whether no more can be lost than `lost` says, as far as the files say."""
        return not self._is_full and all(
            count is not None or file in self._missing
            for (file, _), (_, count) in self._entries.items()
        )

    @property
    def is_lossy(self) -> bool:
        """Whether anything was lost or altered."""
        return bool(self._entries)

    @property
    def errors(self) -> list[str]:
        """What was lost or altered, in order of discovery."""
        texts = [text for text, _ in self._entries.values()]
        more = len(texts) - _MAX_TEXTS
        return [*texts[:_MAX_TEXTS], f'and {more} more'] if more > 0 else texts

    @property
    def warnings(self) -> list[str]:
        """What is unusual, in order of discovery."""
        return list(self._notes.values())

    @property
    def balance(self) -> str:
        """The account in one line."""
        lost = f'{self.lost} lost'
        if not self.is_exact:
            lost = f'at least {lost}' if self.lost else 'an unknown number lost'
        altered = f', {self.altered} altered' if self.altered else ''
        return f'{self.name}: {self.kept} kept, {lost}{altered}'

    def record(self) -> dict[str, Any]:
        """All of it as JSON knows it."""
        return {
            'name': self.name,
            **{key: getattr(self, key) for key in ('kept', 'lost', 'skipped', 'altered')},
            'is_exact': self.is_exact,
            'errors': self.errors,
            'warnings': self.warnings,
        }

    def _messages(self, of: Callable[[Hashable], bool]) -> int:
        return sum(count or 0 for (file, _), (_, count) in self._entries.items() if of(file))


@contextmanager
def collecting() -> Iterator[list[Account]]:
    """The accounts of all that is opened meanwhile in this thread."""
    accounts: list[Account] = []
    token = _collected.set(accounts)
    try:
        yield accounts
    finally:
        _collected.reset(token)


def collect(accounts: Iterable[Account]) -> None:
    """Add accounts that come from elsewhere, such as another process."""
    if (known := _collected.get()) is not None:
        known += [account for account in accounts if account not in known]


def counted(count: int, noun: str) -> str:
    """'1 message', '2 messages'."""
    return f'{count} {noun}' if count == 1 else f'{count} {noun}s'

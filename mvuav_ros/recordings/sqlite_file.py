"""Reading one rosbag2 sqlite3 file in stored order, whole or damaged.

rosbags reads sound files only, and counts and sorts them as a whole before the first message.
Here SQLite reads a cursor at a time, and where it meets damage, what is left of the file's pages
is searched without it.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

from mvuav_ros.recordings.compression import SIZE_LIMIT
from mvuav_ros.recordings.recording import (
    Problems,
    RecordedMessage,
    Schema,
    TopicInfo,
    counted,
    normalised_type,
)
from mvuav_ros.recordings.sqlite_pages import PageFile

_FIRST = -(1 << 63)
_LAST = (1 << 63) - 1
# The second is from names of columns, which are decoded strictly.
_ERRORS = (sqlite3.Error, UnicodeDecodeError, OverflowError, MemoryError)
_SMALLEST_LIMIT = 1 << 20
# A row has ten bytes and takes SQLite some twenty steps.
_STEPS_PER_BYTE = 10
_STEPS = 1000
_MOST_TOPICS = 1 << 16
_MOST_TEXT = 1 << 26


class SqliteFile:
    """One rosbag2 database; it is opened anew for every pass."""

    def __init__(self, path: Path, problems: Problems) -> None:
        self._path = path
        self._problems = problems
        self._topics: dict[int, TopicInfo] | None = None

    def channels(self) -> Sequence[TopicInfo]:
        """Every topic of the database, none if the table of topics cannot be read."""
        if self._topics is None:
            self._topics = {}
            missing = PageFile(self._path).missing_bytes
            if missing:
                self._note('cut', f'cut off; {counted(missing, "byte")} of it are missing')
            try:
                with self._connect() as database:
                    self._topics = _topics(database)
                    if not missing:
                        self._count(database)
            except (*_ERRORS, KeyError, ValueError) as error:
                self._note('error', f'the database is damaged ({error})')
        return tuple(self._topics.values())

    def messages(
        self, topics: Container[str] | None, start_ns: int | None, end_ns: int | None
    ) -> Iterator[RecordedMessage]:
        """The messages in stored order, ``start_ns`` <= log time < ``end_ns``."""
        self.channels()
        assert self._topics is not None
        wanted = {
            key: topic
            for key, topic in self._topics.items()
            if topic.serialization_format == 'cdr' and (topics is None or topic.name in topics)
        }
        first = _FIRST if start_ns is None else max(start_ns, _FIRST)
        last = _LAST if end_ns is None else min(end_ns - 1, _LAST)
        pages = PageFile(self._path)
        position = _FIRST
        # Of a file that was cut off, SQLite takes the missing part of its last page for zeros.
        if not pages.missing_bytes:
            try:
                with self._connect() as database:
                    for rowid, message in _rows(database, wanted, first, last):
                        yield message
                        position = rowid
                return
            except _ERRORS as error:
                self._note('error', f'the database is damaged ({error})')
        for row in pages.messages(position):
            if row.topic_id in wanted and first <= row.stamp_ns <= last:
                yield _message(wanted[row.topic_id], row.stamp_ns, row.data)
        if pages.incomplete_rows:
            self._note('rows', f'{counted(pages.incomplete_rows, "message")} incomplete')

    def _count(self, database: sqlite3.Connection) -> None:
        assert self._topics is not None
        query = 'SELECT topic_id, count(*) FROM messages GROUP BY topic_id'
        counts = dict(database.execute(query))
        for key, topic in self._topics.items():
            self._topics[key] = replace(topic, message_count=counts.get(key, 0))

    @contextmanager
    def _connect(self) -> Iterator[sqlite3.Connection]:
        # A write-ahead log or journal that a crash left behind holds the last messages.
        logs = [log for log in _logs(self._path) if log.exists()]
        shared = Path(f'{self._path}-shm')
        if not all(log.is_file() for log in logs):
            self._note('log', 'the log beside it is no file')
            logs = []
        if not logs:
            with closing(self._opened('mode=ro&immutable=1')) as database:
                yield database
            return
        ours = not shared.exists()
        try:
            database = self._opened('mode=ro')
            database.execute('SELECT count(*) FROM topics').fetchone()
        except sqlite3.OperationalError as error:
            self._note('log', f'the log beside it cannot be used ({error})')
            database = self._opened('mode=ro&immutable=1')
        try:
            with closing(database):
                yield database
        finally:
            if ours:  # SQLite leaves it behind after reading a log
                with suppress(OSError):
                    shared.unlink(missing_ok=True)

    def _opened(self, mode: str) -> sqlite3.Connection:
        database = sqlite3.connect(
            f'file:{quote(str(self._path.absolute()))}?{mode}', uri=True, check_same_thread=False
        )
        database.text_factory = _text
        size = min(self._path.stat().st_size + _log_size(self._path), SIZE_LIMIT)
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, max(size, _SMALLEST_LIMIT))
        # Pages that point at each other would keep SQLite busy for ever.
        budget = iter(range(_STEPS_PER_BYTE * size // _STEPS + 1000))
        database.set_progress_handler(lambda: next(budget, None) is None, _STEPS)
        # Without this, SQLite refuses a file that is shorter than its header says.
        database.execute('PRAGMA writable_schema=ON')
        return database

    def _note(self, key: str, text: str) -> None:
        self._problems.error((self._path, key), f'{self._path.name}: {text}')


def _logs(path: Path) -> list[Path]:
    return [Path(f'{path}{suffix}') for suffix in ('-wal', '-journal')]


def _log_size(path: Path) -> int:
    return sum(log.stat().st_size for log in _logs(path) if log.is_file())


def _topics(database: sqlite3.Connection) -> dict[int, TopicInfo]:
    if _has_views(database):
        raise sqlite3.DatabaseError('its tables are views')
    schemas: dict[str, Schema] = {}
    try:
        for row in _small_rows(database, 'message_definitions'):
            kind = normalised_type(str(row['topic_type']))
            schemas[kind] = Schema(str(row['encoding']), str(row['encoded_message_definition']))
    except (*_ERRORS, KeyError):
        pass  # older bags have no such table
    topics: dict[int, TopicInfo] = {}
    for row in _small_rows(database, 'topics'):
        if not isinstance(row['id'], int):
            continue
        kind = normalised_type(str(row['type']))
        topics[row['id']] = TopicInfo(
            str(row['name']),
            kind,
            None,
            # The first ROS 2 releases knew no other.
            str(row.get('serialization_format', 'cdr')),
            schemas.get(kind),
            str(row.get('offered_qos_profiles', '')),
        )
    return topics


def _has_views(database: sqlite3.Connection) -> bool:
    """Whether it has what can have any number of rows; rosbag2 makes none."""
    query = "SELECT 1 FROM sqlite_master WHERE sql LIKE 'CREATE%VIEW %' OR sql LIKE 'CREATE VIRT%'"
    try:
        return database.execute(query).fetchone() is not None
    except _ERRORS:
        return False


def _small_rows(database: sqlite3.Connection, table: str) -> Iterator[dict[str, Any]]:
    """The rows of a table, as long as there is no more than anybody would write."""
    cursor = database.execute(f'SELECT * FROM {table} LIMIT {_MOST_TOPICS}')
    columns = [column[0] for column in cursor.description]
    left = _MOST_TEXT
    for values in cursor:
        left -= sum(len(value) for value in values if isinstance(value, str | bytes))
        if left < 0:
            raise sqlite3.DatabaseError(f'its table {table} is implausibly large')
        yield dict(zip(columns, values, strict=True))


def _rows(
    database: sqlite3.Connection, wanted: Mapping[int, TopicInfo], first: int, last: int
) -> Iterator[tuple[int, RecordedMessage]]:
    """The messages of some topics by row, ``first`` <= log time <= ``last``."""
    rows = database.execute(
        # The plus signs keep SQLite from walking the time index and then sorting.
        'SELECT rowid, topic_id, timestamp, data FROM messages '
        'WHERE +timestamp >= ? AND +timestamp <= ? '
        f'AND +topic_id IN ({",".join(str(key) for key in wanted)}) ORDER BY rowid',
        (first, last),
    )
    previous = _FIRST
    for rowid, key, stamp_ns, data in rows:
        if rowid <= previous:  # pages that point at each other would go on for ever
            raise sqlite3.DatabaseError('its rows are out of order')
        previous = rowid
        if isinstance(data, bytes) and isinstance(stamp_ns, int):
            yield rowid, _message(wanted[key], stamp_ns, data)


def _message(topic: TopicInfo, stamp_ns: int, data: bytes) -> RecordedMessage:
    return RecordedMessage(topic.name, topic.type, stamp_ns, data, topic.schema, topic.qos)


def _text(raw: bytes) -> str:
    return raw.decode('utf-8', 'replace')

"""Reading one rosbag2 sqlite3 file in stored order, whole or damaged.

rosbags reads sound files only, and counts and sorts them as a whole before the first message.
Here SQLite reads a cursor at a time, and where it meets damage, what is left of the file's pages
is searched without it.
"""

from __future__ import annotations

import os
import sqlite3
from collections import Counter
from collections.abc import Container, Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import quote

from mvuav_ros.messages.definitions import Schema
from mvuav_ros.messages.sensors import normalised_type
from mvuav_ros.recordings.account import counted
from mvuav_ros.recordings.compression import SIZE_LIMIT
from mvuav_ros.recordings.layout import ZSTD_START
from mvuav_ros.recordings.sqlite_pages import PageFile
from mvuav_ros.recordings.stored_file import (
    READABLE_FORMATS,
    RecordingFile,
    StoredMessage,
    TopicInfo,
)

_FIRST = -(1 << 63)
_LAST = (1 << 63) - 1
# The second is from names of columns, which are decoded strictly.
_ERRORS = (sqlite3.Error, UnicodeDecodeError, OverflowError, MemoryError)
_MIN_LIMIT = 1 << 20
# A row has ten bytes and takes SQLite some twenty steps.
_STEPS_PER_BYTE = 10
_STEPS = 1000
_MAX_TOPICS = 1 << 16
_MAX_TEXT = 1 << 26


class SqliteFile(RecordingFile):
    """One rosbag2 database, for which SQLite keeps to limits of its own."""

    def _scan(self, _stream: BinaryIO) -> None:
        """Take in every topic of the database, none if the table of topics cannot be read."""
        missing = PageFile(self._path).missing_bytes
        if missing:
            self.lose('cut', f'cut off; {counted(missing, "byte")} of it are missing')
        try:
            with self._connect() as database:
                for key, topic in _topics(database).items():
                    self._define(key, topic)
                if not missing:
                    query = 'SELECT topic_id, count(*) FROM messages GROUP BY topic_id'
                    self._channels.take_counts(dict(database.execute(query)))
        except (*_ERRORS, KeyError, ValueError) as error:
            self.lose('error', f'the database is damaged ({error})')

    def _stored(
        self, _stream: BinaryIO, topics: Container[str] | None, first_ns: int, end_ns: int
    ) -> Iterator[StoredMessage]:
        wanted = [
            key
            for key, (topic, _) in self._channels.known.items()
            if topic.serialization_format in READABLE_FORMATS
            and (topics is None or topic.name in topics)
        ]
        odd: Counter[str] = Counter()
        for key, stamp_ns, data in self._rows(wanted, first_ns, min(end_ns - 1, _LAST)):
            if not isinstance(stamp_ns, int):
                odd['whose time is no integer'] += 1
            elif data is None:
                odd['whose data are no bytes'] += 1
            else:
                yield key, None, stamp_ns, None, data
        for problem, count in odd.items():
            self.lose(problem, f'{counted(count, "row")} {problem}: skipped', count)

    def _rows(self, wanted: Iterable[int], first: int, last: int) -> Iterator[tuple[Any, Any, Any]]:
        """Topic, stamp and data of every row; the data are empty where nobody needs them."""
        pages = PageFile(self._path)
        position = _FIRST
        keys = ','.join(str(key) for key in wanted)
        # Of a file that was cut off, SQLite takes the missing part of its last page for zeros.
        if not pages.missing_bytes:
            try:
                with self._connect() as database:
                    left = self._size()
                    # Messages that are compressed are all examined: see `RecordingFile.messages`.
                    start = 'SELECT substr(data, 1, 4) FROM messages LIMIT 9'
                    is_packed = (ZSTD_START,) in database.execute(start).fetchall()
                    rows = database.execute(
                        # Of a value whose type alone is asked for, SQLite reads nothing else.
                        "SELECT rowid, topic_id, timestamp, CASE WHEN typeof(data) != 'blob' "
                        f'THEN NULL WHEN ? OR topic_id IN ({keys}) AND timestamp BETWEEN ? AND ? '
                        "THEN data ELSE x'' END FROM messages ORDER BY rowid",
                        (is_packed, first, last),
                    )
                    for rowid, key, stamp_ns, data in rows:
                        left -= len(data) if isinstance(data, bytes) else 0
                        # Pages that point at each other would go on forever.
                        if rowid <= position or left < 0:
                            raise sqlite3.DatabaseError('its rows are out of order')
                        position = rowid
                        yield key, stamp_ns, data
                return
            except _ERRORS as error:
                self.lose('error', f'the database is damaged ({error})')
        yield from pages.messages(position)
        if pages.incomplete_rows:
            incomplete = pages.incomplete_rows
            self.lose('rows', f'{counted(incomplete, "message")} incomplete', incomplete)

    @contextmanager
    def _connect(self) -> Iterator[sqlite3.Connection]:
        # A write-ahead log or journal that a crash left behind holds the last messages.
        logs = [log for log in self._logs if log.exists()]
        if not all(log.is_file() for log in logs):
            self.lose('log', 'the log beside it is no file')
            logs = []
        shared = Path(f'{self._path}-shm')
        ours = bool(logs) and not shared.exists()
        try:
            database = self._opened('mode=ro' if logs else 'mode=ro&immutable=1')
            if logs:
                database.execute('SELECT count(*) FROM topics').fetchone()
        except sqlite3.OperationalError as error:
            if not logs:
                raise
            self.lose('log', f'the log beside it cannot be used ({error})')
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
            f'file:{quote(os.fsencode(self._path.absolute()))}?{mode}',
            uri=True,
            check_same_thread=False,
        )
        database.text_factory = lambda raw: raw.decode('utf-8', 'replace')
        size = min(self._size(), SIZE_LIMIT)
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, max(size, _MIN_LIMIT))
        # Pages that point at each other would keep SQLite busy forever.
        budget = iter(range(_STEPS_PER_BYTE * size // _STEPS + 1000))
        database.set_progress_handler(lambda: next(budget, None) is None, _STEPS)
        # Without this, SQLite refuses a file that is shorter than its header says.
        database.execute('PRAGMA writable_schema=ON')
        return database

    @property
    def _logs(self) -> list[Path]:
        return [Path(f'{self._path}{suffix}') for suffix in ('-wal', '-journal')]

    def _size(self) -> int:
        files = [self._path, *(log for log in self._logs if log.is_file())]
        return sum(file.stat().st_size for file in files)


def _topics(database: sqlite3.Connection) -> dict[int, TopicInfo]:
    # A view can have any number of rows; rosbag2 makes none. By what SQLite makes of the
    # definition, which may be spelt in many ways.
    listed = database.execute('PRAGMA main.table_list').fetchall()
    if any(kind not in ('table', 'shadow') for _, _, kind, *_ in listed):
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


def _small_rows(database: sqlite3.Connection, table: str) -> Iterator[dict[str, Any]]:
    """The rows of a table, as long as there is no more than anybody would write."""
    cursor = database.execute(f'SELECT * FROM {table} LIMIT {_MAX_TOPICS}')
    columns = [column[0] for column in cursor.description]
    left = _MAX_TEXT
    for values in cursor:
        left -= sum(len(value) for value in values if isinstance(value, str | bytes))
        if left < 0:
            raise sqlite3.DatabaseError(f'its table {table} is implausibly large')
        yield dict(zip(columns, values, strict=True))

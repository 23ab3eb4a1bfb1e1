"""Results of one or many flights as files: a table for each topic.

CSV and Parquet take any rows, TUM poses, MOTChallenge markers.
"""

from __future__ import annotations

import csv
import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager, ExitStack
from itertools import chain, count, islice
from pathlib import Path
from secrets import token_hex
from typing import Any, ClassVar

from mvuav_ros.messages.untrusted import MalformedMessageError
from mvuav_ros.recordings.account import Account, RecordingError, counted, needed_for
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.remote import write_text
from mvuav_ros.recordings.result_rows import (
    CLOUD,
    POSE_COLUMNS,
    ROWS_AT_ONCE,
    Columns,
    ResultRows,
    Row,
    is_table,
)
from mvuav_ros.vision.markers.marker_results import Label, MarkerState

_NS = 1_000_000_000


class Table(AbstractContextManager['Table']):
    """One topic's file, a context manager; there when all of it is, else the one before stays.

    Attributes:
        count: of the rows written.
        ending: of the files' names.
        needs: columns without which there is no such table.
        one_flight: whether there is no column for the flight, and so a file for each.
        kinds, topics: parts of the messages' types, and the ends of their topics, that it takes.
    """

    ending: ClassVar[str]
    kinds: ClassVar[str] = ''
    topics: ClassVar[str] = ''
    needs: ClassVar[frozenset[str]] = frozenset()
    one_flight: ClassVar[bool] = False

    def __init__(self, path: Path, columns: Columns) -> None:
        """Begin a file; its folder is made."""
        self.path = path
        self.count = 0
        self._columns = columns
        path.parent.mkdir(parents=True, exist_ok=True)
        # Another export may write the same file meanwhile.
        self._part = path.with_name(f'.{path.name}.{token_hex(4)}')
        self._file = self._part.open('x', encoding='utf-8', newline='')

    @classmethod
    def takes(cls, topic: str, kind: str) -> bool:
        """Whether it can hold the messages of a topic of that type."""
        return is_table(topic, kind) and topic.endswith(cls.topics) and cls.kinds in kind

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            try:
                if kind is None:
                    self._end()
            finally:
                self._close()
            if kind is None:
                self._part.replace(self.path)
        finally:
            self._part.unlink(missing_ok=True)

    def add(self, rows: Iterable[Row], number: int | None = None) -> None:
        """Write the rows, which may be very many, of a message of this number in its recording."""
        remaining = iter(rows)
        while block := list(islice(remaining, ROWS_AT_ONCE)):
            self.count += self._write(block)

    def _write(self, rows: list[Row]) -> int:
        lines = [line for line in map(self._line, rows) if line]
        self._file.writelines(lines)
        return len(lines)

    def _line(self, row: Row) -> str:
        """A row as text; empty if it is none."""
        raise NotImplementedError

    def _end(self) -> None:
        pass

    def _close(self) -> None:
        self._file.close()


class Csv(Table):
    """Comma-separated values, with a line of names."""

    ending = 'csv'

    def __init__(self, path: Path, columns: Columns) -> None:
        super().__init__(path, columns)
        self._writer = csv.writer(self._file)
        self._writer.writerow(columns)

    def _write(self, rows: list[Row]) -> int:
        self._writer.writerows(rows)
        return len(rows)


class Parquet(Table):
    """Apache Parquet, in groups of rows."""

    ending = 'parquet'

    def __init__(self, path: Path, columns: Columns) -> None:
        with needed_for('parquet'):
            import pyarrow
            import pyarrow.parquet
        super().__init__(path, columns)
        self._arrow = pyarrow
        self._rows: list[Row] = []
        self._writer: Any = None

    def _write(self, rows: list[Row]) -> int:
        self._rows += rows
        if len(self._rows) >= ROWS_AT_ONCE:
            self._flush()
        return len(rows)

    def _flush(self) -> None:
        columns = zip(*self._rows, strict=True) if self._rows else ([] for _ in self._columns)
        content = {name: list(rows) for name, rows in zip(self._columns, columns, strict=True)}
        schema = None if self._writer is None else self._writer.schema
        try:
            table = self._arrow.table(content, schema=schema)
        except (ValueError, TypeError, OverflowError) as error:
            raise RecordingError(f'{self.path}: its columns change: {error}') from None
        if self._writer is None:
            self._writer = self._arrow.parquet.ParquetWriter(self._file.buffer, table.schema)
        self._writer.write_table(table)
        self._rows.clear()

    def _end(self) -> None:
        if self._rows or self._writer is None:
            self._flush()

    def _close(self) -> None:
        try:
            # Before the file: it writes that one's end, at the latest when it is collected.
            if self._writer is not None:
                self._writer.close()
        finally:
            super()._close()


class Tum(Table):
    """Time (s), position (m) and quaternion of every pose that is known, as evo reads it."""

    ending = 'tum'
    kinds = 'Pose'
    one_flight = True

    def __init__(self, path: Path, columns: Columns) -> None:
        super().__init__(path, columns)
        self._places = [columns.index(name) for name in ('stamp_ns', *POSE_COLUMNS)]

    def _line(self, row: Row) -> str:
        stamp_ns, *pose = (row[place] for place in self._places)
        numbers = [float(number) for number in pose]
        if not all(map(math.isfinite, numbers)):
            return ''
        seconds, rest = divmod(abs(int(stamp_ns)), _NS)
        sign = '-' if int(stamp_ns) < 0 else ''
        return f'{sign}{seconds}.{rest:09d} {" ".join(map(repr, numbers))}\n'


class Mot(Table):
    """MOTChallenge: a line for each marker that was measured, as TrackEval reads it.

    frame (from 1), id (the marker's label and 1, or the light's number, or -1 of a light without
    one), left, top, width and height of a box with the marker's area (px, the first pixel's corner
    at 1), confidence (1 where there is none), and -1 three times.
    """

    ending = 'txt'
    kinds = CLOUD
    topics = '/markers'
    needs = frozenset(('label', 'state', 'x', 'y', 'area'))
    one_flight = True
    _frame = 0

    def add(self, rows: Iterable[Row], number: int | None = None) -> None:
        """See `Table`; each message is a frame. Others, without one, are counted in its number."""
        self._frame = max(self._frame + 1, number or 0)
        super().add(rows)

    def _line(self, row: Row) -> str:
        of = dict(zip(self._columns, row, strict=True))
        label = float(of['label'])
        light = float(of.get('id', -1.0 if label == Label.UNLABELLED else label + 1.0))
        x, y, area = (float(of[name]) for name in ('x', 'y', 'area'))
        if of['state'] != MarkerState.DETECTED or not math.isfinite(light + x + y + area):
            return ''
        side = math.sqrt(max(area, 1.0))
        left, top = x - 0.5 * side + 1.5, y - 0.5 * side + 1.5
        confidence = float(of.get('confidence', math.nan))
        known = confidence if math.isfinite(confidence) else 1.0
        box = f'{left:.3f},{top:.3f},{side:.3f},{side:.3f}'
        return f'{self._frame},{int(light)},{box},{known:g},-1,-1,-1\n'


TABLES: dict[str, type[Table]] = {'csv': Csv, 'parquet': Parquet, 'tum': Tum, 'mot': Mot}
"""By the form's name."""


_MAX_NAME = 200
_MAX_REASON = 200
_MAX_TABLES = 500


def export(
    flights: Mapping[str, Path], folder: Path, form: str, *, overwrite: bool = False
) -> dict[Path, int]:
    """Write one file for each topic that can be a table, with the rows of all flights.

    Tables are made of PointCloud2 (markers, lines), Vector3Stamped (roll), PointStamped, and
    poses with and without covariance. Of several flights each has TUM and MOT files of its own, in
    a folder for each topic. What was lost is in ``account_FORM.json`` beside them: messages that
    do not decode, too.

    Args:
        flights: recordings of results by the names of their flights.
        folder: where the files go; it is made.
        form: 'csv', 'parquet', 'tum' or 'mot'.
        overwrite: replace files that exist.

    Returns:
        The tables with the number of their rows.

    Raises:
        RecordingError: there is nothing to export, or a file exists.
    """
    accounts: list[Account] = []
    try:
        with ExitStack() as stack:
            files = _Files(folder, form, overwrite, several=len(flights) > 1)
            for flight, source in flights.items():
                accounts.append(_export(flight, source, files, stack))
        if files.tables:
            content = [account.record() for account in accounts]
            record = content[0] if len(content) == 1 else {'flights': content}
            write_text(str(files.account), json.dumps(record, indent=2))
    except OSError as error:
        raise RecordingError(f'{folder} cannot be written: {error.strerror or error}') from None
    if not files.tables:
        names = ', '.join(map(str, flights.values()))
        raise RecordingError(f'{names} holds nothing that can be exported as {form}')
    return {table.path: table.count for table in files.tables.values()}


def _export(flight: str, source: Path, files: _Files, stack: ExitStack) -> Account:
    lost: Counter[tuple[str, str]] = Counter()
    with open_recording(source) as recording, ExitStack() as own:
        rows = ResultRows(recording, flight)
        takes = files.table_type.takes
        wanted = {name: kind for name, kind in rows.kinds.items() if takes(name, kind)}
        for topic in wanted:  # before anything is written
            files.refuse_to_overwrite(topic, flight)
        for message in recording.messages(wanted):
            if not takes(message.topic, message.type):
                continue
            try:
                columns, values = rows.of(message)
                if missing := files.table_type.needs - set(columns):
                    raise MalformedMessageError(f'it has no {", ".join(sorted(missing))}')
            except MalformedMessageError as error:
                lost[message.topic, str(error)[:_MAX_REASON]] += 1
                continue
            until = own if files.table_type.one_flight else stack
            files.table(message.topic, flight, columns, until).add(values, message.sequence)
        for (name, reason), count in lost.items():
            said = f'{counted(count, "message")} of {name} not exported: {reason}'
            recording.account.lose('export', (name, reason), said, count)
    return recording.account


class _Files:
    """A file for each table, of a name of its own.

    ``tables`` are those begun, by topic, columns and, where each flight has its own, flight;
    what was lost goes into the file ``account``.
    """

    def __init__(self, folder: Path, form: str, overwrite: bool, *, several: bool) -> None:
        self._folder, self._overwrite, self._several = folder, overwrite, several
        self.table_type = TABLES[form]
        self.account = folder / f'account_{form}.json'
        self.tables: dict[tuple[str, Columns, str], Table] = {}

    def refuse_to_overwrite(self, topic: str, flight: str) -> None:
        """Raise RecordingError where the topic's file exists, before anything is written."""
        if not self.tables:
            self._refuse(self.account)
        of = flight if self.table_type.one_flight else ''
        if not any(known == topic and its == of for known, _, its in self.tables):
            self._free_path(topic, flight)

    def table(self, topic: str, flight: str, columns: Columns, stack: ExitStack) -> Table:
        """The table of a topic's messages with these columns; others have one of their own.

        Raises:
            RecordingError: its file exists, or there are too many.
        """
        key = topic, columns, flight if self.table_type.one_flight else ''
        if key not in self.tables:
            if len(self.tables) == _MAX_TABLES:
                raise RecordingError(f'it would be more than {_MAX_TABLES} tables')
            path = self._free_path(topic, flight)
            self.tables[key] = stack.enter_context(self.table_type(path, columns))
        return self.tables[key]

    def _free_path(self, topic: str, flight: str) -> Path:
        name = re.sub(r'[^\w.-]', '_', topic.strip('/'))[:_MAX_NAME] or 'root'
        inner = f'/{flight}' if self.table_type.one_flight and self._several else ''
        taken = {table.path for table in self.tables.values()}
        ending = f'{inner}.{self.table_type.ending}'
        names = chain((name,), (f'{name}_{number}' for number in count(2)))
        path = next(p for n in names if (p := self._folder / f'{n}{ending}') not in taken)
        self._refuse(path)
        return path

    def _refuse(self, path: Path) -> None:
        if path.exists() and not self._overwrite:
            raise RecordingError(f'{path} exists; choose another folder, or overwrite it (--force)')

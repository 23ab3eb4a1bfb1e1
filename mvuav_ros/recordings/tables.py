"""Files of rows: CSV and Parquet for anything, TUM for poses, MOT for markers."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from io import TextIOWrapper
from itertools import islice
from pathlib import Path
from typing import Any

from mvuav_ros.recordings.errors import RecordingError

Row = tuple[int | float | str, ...]
ROWS_AT_ONCE = 10_000
_NS = 1_000_000_000
POSE_COLUMNS = ('x', 'y', 'z', 'qx', 'qy', 'qz', 'qw')
_DETECTED = 1
"""The state of a marker that was measured in its frame."""


class Table:
    """One topic's file, a context manager.

    Attributes:
        path: of the file, which is there when all of it is; after an error the one before stays.
        count: of the rows written.
    """

    def __init__(self, path: Path, columns: tuple[str, ...]) -> None:
        """Begin a file; its folder is made."""
        self.path = path
        self.count = 0
        self._columns = columns
        path.parent.mkdir(parents=True, exist_ok=True)
        self._part = path.with_name(f'.{path.name}.part')
        self._file = self._part.open('wb')

    def __enter__(self) -> Table:
        return self

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

    def add(self, rows: Iterable[Row]) -> None:
        """Write a message's rows, which may be very many."""
        self._begin_message()
        remaining = iter(rows)
        while block := list(islice(remaining, ROWS_AT_ONCE)):
            self.count += self._write(block)

    def _begin_message(self) -> None:
        pass

    def _write(self, rows: list[Row]) -> int:
        raise NotImplementedError

    def _end(self) -> None:
        pass

    def _close(self) -> None:
        self._file.close()


class Csv(Table):
    """Comma-separated values, with a line of names."""

    def __init__(self, path: Path, columns: tuple[str, ...]) -> None:
        super().__init__(path, columns)
        self._text = TextIOWrapper(self._file, 'utf-8', newline='', write_through=True)
        self._writer = csv.writer(self._text)
        self._writer.writerow(columns)

    def _write(self, rows: list[Row]) -> int:
        self._writer.writerows(rows)
        return len(rows)

    def _end(self) -> None:
        self._text.flush()


class Parquet(Table):
    """Apache Parquet, in groups of rows."""

    def __init__(self, path: Path, columns: tuple[str, ...]) -> None:
        try:
            import pyarrow
            import pyarrow.parquet
        except ImportError as error:
            raise RecordingError(
                f'parquet needs PyArrow: pip install "mvuav_ros[parquet]" ({error})'
            ) from error
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
            self._writer = self._arrow.parquet.ParquetWriter(self._file, table.schema)
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

    def __init__(self, path: Path, columns: tuple[str, ...]) -> None:
        """See `Table`."""
        super().__init__(path, columns)
        self._places = [columns.index(name) for name in ('stamp_ns', *POSE_COLUMNS)]

    def _write(self, rows: list[Row]) -> int:
        written = 0
        for row in rows:
            pose = [float(row[place]) for place in self._places[1:]]
            if not all(map(math.isfinite, pose)):
                continue
            seconds, rest = divmod(int(row[self._places[0]]), _NS)
            numbers = ' '.join(map(repr, pose))
            self._file.write(f'{seconds}.{rest:09d} {numbers}\n'.encode())
            written += 1
        return written


class Mot(Table):
    """MOTChallenge: a line for each marker that was measured, as TrackEval reads it.

    frame (from 1), id (from 1: the marker's label, or the light's number), left, top, width and
    height of a box with the marker's area (px, the first pixel's corner at 1), confidence, and -1
    three times.
    """

    def __init__(self, path: Path, columns: tuple[str, ...]) -> None:
        """See `Table`."""
        super().__init__(path, columns)
        self._frame = 0

    def _begin_message(self) -> None:
        self._frame += 1

    def _write(self, rows: list[Row]) -> int:
        written = 0
        for row in rows:
            of = dict(zip(self._columns, row, strict=True))
            if of['state'] != _DETECTED:
                continue
            number = int(of.get('id', of['label'])) + 1
            x, y, area = (float(of[name]) for name in ('x', 'y', 'area'))
            side = math.sqrt(max(area, 1.0))
            left, top = x - 0.5 * side + 1.5, y - 0.5 * side + 1.5
            confidence = float(of.get('confidence', 1.0))
            box = f'{left:.3f},{top:.3f},{side:.3f},{side:.3f}'
            self._file.write(f'{self._frame},{number},{box},{confidence:g},-1,-1,-1\n'.encode())
            written += 1
        return written


TABLES: dict[str, type[Table]] = {'csv': Csv, 'parquet': Parquet, 'tum': Tum, 'mot': Mot}
"""By the form's name."""

"""Results of one or many flights as one file for each topic; the forms are in `tables`."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path

from mvuav_ros.messages.untrusted import MalformedMessageError
from mvuav_ros.recordings.account import Account, RecordingError
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.recording import counted
from mvuav_ros.recordings.remote import write_text
from mvuav_ros.recordings.tables import TABLES, Columns, ResultRows, Table, is_table

ACCOUNT = 'account.json'
"""Beside the tables: what could not be read or exported."""

_MAX_NAME = 200
_MAX_REASON = 200
_MAX_TABLES = 500
_ENDINGS = {'mot': 'txt'}
_ONE_FLIGHT = ('tum', 'mot')
"""Forms without a column for the flight."""


def export(
    flights: Mapping[str, Path], folder: Path, form: str, *, overwrite: bool = False
) -> dict[Path, int]:
    """Write one file for each topic that can be a table, with the rows of all flights.

    Tables are made of PointCloud2 (markers, lines), Vector3Stamped (roll), PointStamped, and
    poses with and without covariance. TUM has poses only, and of them those that are known; MOT
    has markers only, and of them those that were measured. Of several flights each has TUM and
    MOT files of its own, in a folder for each topic. What was lost is in ``account.json`` beside
    them: messages that do not decode, too.

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
            write_text(str(folder / ACCOUNT), json.dumps(record, indent=2))
    except OSError as error:
        raise RecordingError(f'{folder} cannot be written: {error.strerror or error}') from None
    if not files.tables:
        names = ', '.join(map(str, flights.values()))
        raise RecordingError(f'{names} holds nothing that can be exported as {form}')
    return {table.path: table.count for table in files.tables.values()}


def _export(flight: str, source: Path, files: _Files, stack: ExitStack) -> Account:
    """Add one flight's rows."""
    lost: Counter[tuple[str, str]] = Counter()
    with open_recording(source) as recording, ExitStack() as own:
        rows = ResultRows(recording, flight)
        wanted = {name: kind for name, kind in rows.kinds.items() if files.takes(name, kind)}
        for topic in wanted:  # before anything is written
            files.refuse_to_overwrite(topic, flight)
        for message in recording.messages(wanted):
            if not files.takes(message.topic, message.type):
                continue
            try:
                columns, values = rows.of(message)
            except MalformedMessageError as error:
                lost[message.topic, str(error)[:_MAX_REASON]] += 1
                continue
            files.table(message.topic, flight, columns, own if files.one_flight else stack).add(
                values
            )
        for (name, reason), count in lost.items():
            said = f'{counted(count, "message")} of {name} not exported: {reason}'
            recording.account.lose('export', (name, reason), said, count)
    return recording.account


class _Files:
    """A file for each table, of a name of its own.

    Attributes:
        tables: those begun, by topic, columns and, where each flight has its own, flight.
        one_flight: whether each flight has its own.
    """

    def __init__(self, folder: Path, form: str, overwrite: bool, *, several: bool) -> None:
        self._folder, self._form, self._overwrite = folder, form, overwrite
        self._several = several
        self.one_flight = form in _ONE_FLIGHT
        self.tables: dict[tuple[str, Columns, str], Table] = {}
        self._taken: dict[Path, str] = {}

    def takes(self, topic: str, kind: str) -> bool:
        """Whether the form can hold a topic's messages."""
        if self._form == 'mot':
            return kind.endswith('PointCloud2') and topic.endswith('/markers')
        return is_table(topic, kind) and (self._form != 'tum' or 'Pose' in kind)

    def refuse_to_overwrite(self, topic: str, flight: str) -> None:
        """Look before anything is written.

        Raises:
            RecordingError: the topic's file exists.
        """
        if not self._is_begun(topic, flight):
            self._free_path(topic, flight)

    def table(self, topic: str, flight: str, columns: Columns, stack: ExitStack) -> Table:
        """The table of a topic's messages with these columns; others have one of their own.

        Raises:
            RecordingError: its file exists, or there are too many.
        """
        key = topic, columns, flight if self.one_flight else ''
        if key not in self.tables:
            if len(self.tables) == _MAX_TABLES:
                raise RecordingError(f'it would be more than {_MAX_TABLES} tables')
            path = self._free_path(topic, flight)
            self._taken[path] = topic
            self.tables[key] = stack.enter_context(TABLES[self._form](path, columns))
        return self.tables[key]

    def _is_begun(self, topic: str, flight: str) -> bool:
        of = flight if self.one_flight else ''
        return any(known == topic and its == of for known, _, its in self.tables)

    def _free_path(self, topic: str, flight: str) -> Path:
        name = re.sub(r'[^\w.-]', '_', topic.strip('/'))[:_MAX_NAME] or 'root'
        ending = _ENDINGS.get(self._form, self._form)
        number = 1
        while True:
            table = name if number == 1 else f'{name}_{number}'
            inner = f'{table}/{flight}' if self.one_flight and self._several else table
            path = self._folder / f'{inner}.{ending}'
            if path not in self._taken:
                break
            number += 1
        if path.exists() and not self._overwrite:
            raise RecordingError(f'{path} exists; choose another folder, or overwrite it (--force)')
        return path

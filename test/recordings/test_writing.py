"""What is written can be read by everyone, however the writing ends."""

from __future__ import annotations

import errno
import os
import resource
import shutil
import signal
import struct
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from rosbags import rosbag2
from support.commands import started
from support.places import ROOT
from support.recording_samples import (
    IMAGE,
    START_NS,
    STORE,
    TOPIC,
    Sample,
    image_samples,
    read_samples,
    string_sample,
    write_ros1,
    write_rosbag2,
)

from mvuav_ros.messages.definitions import Schema
from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.remote import write_whole
from mvuav_ros.recordings.rosbag2_folder import Rosbag2Writer, open_writer
from mvuav_ros.recordings.writing import RecordingWriter

SAMPLES = [*image_samples(600), string_sample(600), string_sample(601, '/other')]


def write(path: Path, samples: list[Sample]) -> None:
    with RecordingWriter(path) as writer:
        for sample in samples:
            writer.write(*sample)


def test_read_back_by_everyone(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    write(path, SAMPLES)
    assert read_samples(path) == (SAMPLES, [])
    with rosbag2.Reader(path) as reader:
        assert [Sample(c.topic, c.msgtype, t, d) for c, t, d in reader.messages()] == SAMPLES
        for connection in reader.connections:
            text, _ = STORE.generate_msgdef(connection.msgtype, ros_version=2)
            assert connection.msgdef.data == text
            (qos,) = connection.ext.offered_qos_profiles
            assert qos.reliability.name == 'RELIABLE'
    with path.open('rb') as stream:
        indexed = make_reader(stream, validate_crcs=True)
        summary = indexed.get_summary()
        assert summary is not None and summary.statistics is not None
        assert indexed.get_header().profile == 'ros2'
        assert summary.statistics.message_count == len(SAMPLES)
        assert summary.statistics.message_start_time == SAMPLES[0].stamp_ns
        assert summary.statistics.message_end_time == SAMPLES[-1].stamp_ns
        assert {c.metadata['topic_type_hash'] for c in summary.channels.values()} == {
            STORE.hash_rihs01(IMAGE),
            STORE.hash_rihs01('std_msgs/msg/String'),
        }
        for chunk in summary.chunk_indexes:
            # A chunk is half a second of the messages' own time, however fast they are written.
            assert chunk.message_end_time - chunk.message_start_time < 500_000_000
            for channel, offset in chunk.message_index_offsets.items():
                stream.seek(offset)
                opcode, _, indexed_channel = struct.unpack('<BQH', stream.read(11))
                assert (opcode, indexed_channel) == (Opcode.MESSAGE_INDEX, channel)
        # Backwards is only possible through the chunk and message indexes.
        (_, _, message), *_ = indexed.iter_messages([TOPIC], reverse=True)
        assert message.data == SAMPLES[599].data
    records = list(StreamReader(str(path), validate_crcs=True).records)
    assert len(records) > len(SAMPLES)


def test_a_buffer_may_be_used_again_once_its_message_was_given(tmp_path: Path) -> None:
    """The thread writes it up to half a second later."""
    path = tmp_path / 'a.mcap'
    samples = [string_sample(number) for number in range(600, 620)]
    buffer = bytearray(max(len(sample.data) for sample in samples))
    with RecordingWriter(path) as writer:
        for sample in samples:
            size = len(sample.data)
            buffer[:size] = sample.data
            writer.write(*sample[:3], memoryview(buffer)[:size])
    assert read_samples(path) == (samples, [])


def test_the_same_messages_give_the_same_file(tmp_path: Path) -> None:
    for name in ('a.mcap', 'b.mcap'):
        write(tmp_path / name, SAMPLES)
    assert (tmp_path / 'a.mcap').read_bytes() == (tmp_path / 'b.mcap').read_bytes()


def test_copies_keep_their_definition_and_qos(tmp_path: Path) -> None:
    text = 'uint8 mine\n'
    source = tmp_path / 'in.mcap'
    schema = Schema('ros2msg', text)
    with RecordingWriter(source) as writer:
        writer.write('/own', 'own_msgs/msg/Own', 5, b'\0\1\0\0\7', schema, '- depth: 3\n')
        writer.write('/unknown', 'own_msgs/msg/Other', 6, b'\0\1\0\0\7')
    with open_recording(source) as recording, RecordingWriter(tmp_path / 'out.mcap') as writer:
        messages = list(recording.messages())
        for message in messages:
            writer.write(*message)
    with open_recording(tmp_path / 'out.mcap') as recording:
        assert list(recording.messages()) == messages
        own, unknown = recording.topics
    assert (own.schema, own.qos) == (schema, '- depth: 3\n')
    assert unknown.schema is None


@pytest.mark.parametrize('kind', ['sqlite3', 'ros1'])
def test_copies_from_other_storages_decode(tmp_path: Path, kind: str) -> None:
    samples = image_samples(4)
    if kind == 'ros1':
        source = write_ros1(tmp_path / 'in.bag', samples)
    else:
        source = write_rosbag2(tmp_path / 'in', samples, 'sqlite3')
    target = tmp_path / 'out.mcap'
    with open_recording(source) as recording, RecordingWriter(target) as writer:
        for message in recording.messages():
            writer.write(*message)
    assert read_samples(target) == (samples, [])
    with rosbag2.Reader(target) as reader:
        (connection,) = reader.connections
        assert 'builtin_interfaces/Time stamp' in connection.msgdef.data
        assert 'seq' not in connection.msgdef.data


def test_the_folder_is_made_and_a_file_in_it_is_kept_unless_overwritten(tmp_path: Path) -> None:
    path = tmp_path / 'new' / 'folder' / 'a.mcap'
    write(path, SAMPLES[:1])
    with pytest.raises(RecordingError, match='exists'):
        RecordingWriter(path)
    assert read_samples(path) == (SAMPLES[:1], [])
    with RecordingWriter(path, overwrite=True) as writer:
        writer.write(*SAMPLES[1])
    assert read_samples(path) == (SAMPLES[1:2], [])


def test_impossible_targets_are_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / 'folder.mcap').mkdir()
    (tmp_path / 'folder.mcap' / 'file').touch()
    for name, words in {
        'a.bag': 'must end in .mcap',
        'folder.mcap': 'is a folder',
        'folder.mcap/file/a.mcap': 'folder.mcap/file cannot be made',
    }.items():
        with pytest.raises(RecordingError, match=words) as refusal:
            RecordingWriter(tmp_path / name)
        assert '\n' not in str(refusal.value)


@pytest.mark.parametrize('interruption', [KeyboardInterrupt, SystemExit])
def test_interrupted_by_the_user_it_is_complete(
    tmp_path: Path, interruption: type[BaseException]
) -> None:
    path = tmp_path / 'a.mcap'
    with pytest.raises(interruption), RecordingWriter(path) as writer:
        for sample in SAMPLES[:10]:
            writer.write(*sample)
        raise interruption
    assert read_samples(path) == (SAMPLES[:10], [])


def test_after_a_crash_it_does_not_look_complete(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    with pytest.raises(ZeroDivisionError), RecordingWriter(path) as writer:
        for sample in SAMPLES[:10]:
            writer.write(*sample)
        raise ZeroDivisionError
    got, errors = read_samples(path)
    assert got == SAMPLES[:10]
    assert 'index is missing' in errors[0]
    with open_recording(path) as recording:
        list(recording.messages())
        assert 'unknown number lost' in recording.account.balance


def test_killed_writer_leaves_all_that_it_had_flushed(tmp_path: Path) -> None:
    """It flushes by itself while messages go on; what a copy of the file held stays."""
    path, copy = tmp_path / 'a.mcap', tmp_path / 'copy.mcap'
    code = f"""
import time
from support.recording_samples import string_sample
from mvuav_ros.recordings.writing import RecordingWriter
writer = RecordingWriter({str(path)!r})
for number in range(100_000):
    sample = string_sample(0)._replace(stamp_ns=number)  # one chunk by the messages' time
    writer.write(*sample)
    print(number, flush=True)
    time.sleep(0.02)
"""
    environment = {**os.environ, 'PYTHONPATH': f'{ROOT}:{ROOT / "test"}'}
    flushed: list[Sample] = []
    with started(
        [sys.executable, '-c', code], stdout=subprocess.PIPE, text=True, env=environment
    ) as process:
        assert process.stdout is not None
        deadline = time.monotonic() + 120
        while len(flushed) <= 20:
            assert process.stdout.readline(), 'the writer ended'
            assert time.monotonic() < deadline, f'only {len(flushed)} messages were flushed'
            shutil.copy(path, copy)
            with suppress(RecordingError):  # nothing is in it yet
                flushed, _ = read_samples(copy)
        process.send_signal(signal.SIGKILL)
    got, errors = read_samples(path)
    assert got[: len(flushed)] == flushed
    assert [sample.stamp_ns for sample in got] == list(range(len(got)))
    assert errors


def test_idle_writer_flushes_by_itself(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    with RecordingWriter(path) as writer:
        writer.write(*SAMPLES[0])
        deadline = time.monotonic() + 60
        while path.stat().st_size < 3000:
            assert time.monotonic() < deadline, 'nothing was flushed'
            time.sleep(0.05)
        assert read_samples(path)[0] == SAMPLES[:1]


@pytest.mark.parametrize('room', [0, 1000, 500_000])
def test_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: int) -> None:
    path = tmp_path / 'a.mcap'
    is_room = room > 1000
    real_write = os.write

    def write_until_full(file: int, data: bytes) -> int:
        nonlocal room
        written = real_write(file, data[:room]) if room else 0
        room -= written
        if not written:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return written

    monkeypatch.setattr(os, 'write', write_until_full)
    with pytest.raises(RecordingError, match='No space left on device') as failure:
        write(path, SAMPLES)
    monkeypatch.undo()
    assert '\n' not in str(failure.value)
    assert str(failure.value).endswith('can be read' if is_room else 'cannot be written')
    assert path.exists() is is_room, 'nothing is in the way of the next attempt'
    if not is_room:
        return
    got, errors = read_samples(path)
    assert got == SAMPLES[: len(got)]
    assert len(got) > 100
    assert len(errors) == 1  # no index, but no torn record either


def test_writing_after_closing_is_refused(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / 'a.mcap')
    writer.close()
    writer.close()
    with pytest.raises(RecordingError, match='closed'):
        writer.write(*SAMPLES[0])


def test_stamps_in_any_order(tmp_path: Path) -> None:
    stamps = [START_NS, START_NS - 10**10, START_NS + 10**10, 0, START_NS]
    samples = [SAMPLES[0]._replace(stamp_ns=stamp) for stamp in stamps]
    write(tmp_path / 'a.mcap', samples)
    assert read_samples(tmp_path / 'a.mcap') == (samples, [])


def test_metadata_at_the_beginning(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    with RecordingWriter(path, metadata={'made': {'by': 'me'}}) as writer:
        # There at once, whatever comes.
        assert b'by' in path.read_bytes()
        for sample in SAMPLES:
            writer.write(*sample)
    assert read_samples(path) == (SAMPLES, [])
    with path.open('rb') as stream:
        indexed = make_reader(stream, validate_crcs=True)
        found = {record.name: record.metadata for record in indexed.iter_metadata()}
        summary = indexed.get_summary()
    assert found == {'made': {'by': 'me'}}
    assert summary is not None and summary.statistics is not None
    assert summary.statistics.metadata_count == 1
    with rosbag2.Reader(path) as reader:
        assert reader.message_count == len(SAMPLES)
    assert len(list(StreamReader(str(path), validate_crcs=True).records)) > len(SAMPLES)


@pytest.mark.parametrize('late', [False, True])
def test_of_two_writers_of_one_file_one_gets_an_error(tmp_path: Path, late: bool) -> None:
    path = tmp_path / 'a.mcap'
    first = RecordingWriter(path)
    first.write('/a', IMAGE, 1, b'\0\1\0\0')
    second = RecordingWriter(path, overwrite=True)
    second.write('/b', IMAGE, 2, b'\0\1\0\0')
    if late:
        second.close()
    with pytest.raises(RecordingError, match='another program has replaced it'):
        first.close()
    if not late:
        second.close()
    with open_recording(path) as recording:
        assert [message.topic for message in recording.messages()] == ['/b']


def test_a_file_that_cannot_be_written_whole_is_named_and_not_left(tmp_path: Path) -> None:
    path = tmp_path / 'figure.png'
    path.write_bytes(b'before')
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, limits[1]))
    try:
        with pytest.raises(RecordingError, match=r'figure\.png cannot be written'):
            write_whole(path, bytes(20_000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == b'before'
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_whose_metadata_find_no_room_has_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, limits = tmp_path / 'a', resource.getrlimit(resource.RLIMIT_FSIZE)
    content = Rosbag2Writer._metadata

    def with_little_room(writer: Rosbag2Writer) -> dict[str, Any]:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))
        return content(writer)

    monkeypatch.setattr(Rosbag2Writer, '_metadata', with_little_room)
    try:
        with (
            pytest.raises(RecordingError, match=r'a/metadata\.yaml cannot be written'),
            open_writer(folder, 0) as writer,
        ):
            writer.write(*SAMPLES[0])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [file.name for file in folder.iterdir()] == ['a_0.mcap']


@pytest.mark.parametrize('path', [Path(), Path('/')])
def test_a_folder_without_a_name_is_told_from_a_file_too(path: Path) -> None:
    with pytest.raises(RecordingError, match='is a folder; give the name of a file'):
        write_whole(path, 'words')

"""What can be read of a damaged recording becomes a sound one."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.reader import make_reader
from rosbags import rosbag2
from support.recording_samples import Sample, image_samples, string_sample, write_mcap, write_ros1

from mvuav_ros.recordings.account import RecordingError, collecting
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.repairing import repair
from mvuav_ros.recordings.writing import RecordingWriter

SAMPLES = sorted(
    [*image_samples(40), *(string_sample(number) for number in range(40))],
    key=lambda sample: sample.stamp_ns,
)


def read(path: Path) -> list[Sample]:
    with open_recording(path) as recording:
        messages = [Sample(*message[:4]) for message in recording.messages()]
        assert recording.account.errors == []
        return messages


def test_all_topics_of_a_file_that_was_cut_off(tmp_path: Path) -> None:
    damaged = write_mcap(tmp_path / 'a.mcap', SAMPLES)
    damaged.write_bytes(damaged.read_bytes()[:-40_000])
    with collecting() as accounts:
        messages = repair(damaged, tmp_path / 'out.mcap')
    whole = read(tmp_path / 'out.mcap')
    assert whole == SAMPLES[: len(whole)]
    assert 20 < len(whole) == messages.total()
    assert set(messages) == {'/camera/image_raw', '/note'}
    assert any('cut off' in error for error in accounts[0].errors)
    with (tmp_path / 'out.mcap').open('rb') as stream:
        assert len(list(make_reader(stream, validate_crcs=True).iter_messages())) == len(whole)


def test_what_is_skipped_is_said(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / 'a.mcap', SAMPLES, encodings={'/note': 'json'})
    with collecting() as accounts:
        repair(source, tmp_path / 'out.mcap')
    (account,) = accounts
    assert account.errors == ['skipped: /note is json, not CDR', '40 messages skipped']
    assert (account.kept, account.lost, account.is_exact) == (40, 40, True)


def test_a_rosbag2_folder_split_by_size(tmp_path: Path) -> None:
    source = write_ros1(tmp_path / 'a.bag', [*image_samples(600, 128, 96)])
    folder = tmp_path / 'flight'
    repair(source, folder, split_bytes=3_000_000)
    parts = sorted(folder.glob('flight_*.mcap'))
    assert len(parts) >= 2
    assert all(part.stat().st_size < 6_000_000 for part in parts)
    assert len(read(folder)) == 600
    with rosbag2.Reader(folder) as reader:
        assert reader.message_count == 600
        assert [connection.topic for connection in reader.connections] == ['/camera/image_raw']
        assert sum(1 for _ in reader.messages()) == 600
    with pytest.raises(RecordingError, match='not empty'):
        repair(source, folder, split_bytes=0)
    # With a file of somebody else among them, its own are not removed either.
    (folder / 'notes.txt').touch()
    before = sorted(folder.iterdir())
    with pytest.raises(RecordingError, match='not empty'):
        repair(source, folder, split_bytes=0, overwrite=True)
    assert sorted(folder.iterdir()) == before


def test_the_input_is_never_the_output(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / 'a.mcap', SAMPLES)
    for output in (source, tmp_path):
        with pytest.raises(RecordingError, match='the input itself'):
            repair(source, output, overwrite=True)
    assert len(read(source)) == len(SAMPLES)


def test_a_run_that_fails_at_once_leaves_nothing_in_the_way(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    with pytest.raises(ZeroDivisionError), RecordingWriter(path, metadata={'a': {'b': 'c'}}):
        raise ZeroDivisionError
    assert not path.exists()
    RecordingWriter(path).close()

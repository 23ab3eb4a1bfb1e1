"""Damaged recordings: everything that is whole is read, and what is lost is said."""

from __future__ import annotations

import random
import re
import shutil
import sqlite3
import tracemalloc
from contextlib import closing
from pathlib import Path

import pytest
from rosbags.typesys.store import Typestore
from support.recording_samples import (
    Sample,
    image_samples,
    mcap_ends,
    read_samples,
    ros1_ends,
    sqlite_ends,
    storage_file,
    string_sample,
    write_mcap,
    write_ros1,
    write_rosbag2,
)

from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.rosbag2_folder import open_writer

SAMPLES = image_samples(30)
CUTS = 60


def assert_cuts_are_survived(path: Path, ends: list[int], cut_path: Path) -> None:
    """Cut at random places, and around the messages' ends, where errors by one would show."""
    assert len(ends) == len(SAMPLES)
    content = path.read_bytes()
    choose = random.Random(4)
    cuts = [choose.randrange(len(content)) for _ in range(CUTS)]
    cuts += [choose.choice(ends) + choose.randrange(-2, 3) for _ in range(CUTS // 3)]
    readable = 0
    for cut in cuts:
        cut_path.write_bytes(content[:cut])
        whole = sum(end <= cut for end in ends)
        try:
            got, errors = read_samples(cut_path)
        except RecordingError:
            assert whole == 0, f'{whole} messages are whole at {cut}'
            continue
        readable += 1
        assert got == SAMPLES[: len(got)]
        assert len(got) >= whole, f'{len(got)} of {whole} messages read at {cut}'
        assert errors
    assert readable > CUTS / 2


@pytest.mark.parametrize('compression', ['zstd', 'lz4', 'none'])
@pytest.mark.parametrize('summary', [True, False])
def test_cut_mcap(tmp_path: Path, compression: str, summary: bool) -> None:
    path = write_mcap(tmp_path / 'a.mcap', SAMPLES, compression, summary=summary)
    assert_cuts_are_survived(path, mcap_ends(path), tmp_path / 'cut.mcap')


def test_a_chunk_that_is_cut_off_holds_no_damaged_definition(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / 'a.mcap', SAMPLES, 'none')
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(path.read_bytes()[:25_000])
    _, errors = read_samples(cut)
    assert any('cut off' in error for error in errors)
    assert not any('definition' in error or 'schema' in error for error in errors)


def test_cut_mcap_without_chunks(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / 'a.mcap', SAMPLES, chunk_size=None)
    assert_cuts_are_survived(path, mcap_ends(path), tmp_path / 'cut.mcap')


def test_cut_sqlite(tmp_path: Path) -> None:
    path = storage_file(write_rosbag2(tmp_path / 'bag', SAMPLES, 'sqlite3'))
    assert_cuts_are_survived(path, sqlite_ends(path, SAMPLES), tmp_path / 'cut.db3')


@pytest.mark.parametrize('compression', ['none', 'lz4', 'bz2'])
def test_cut_ros1(tmp_path: Path, compression: str) -> None:
    path = write_ros1(tmp_path / 'a.bag', SAMPLES, compression)
    assert_cuts_are_survived(path, ros1_ends(path), tmp_path / 'cut.bag')


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_cut_zstd_file(tmp_path: Path, storage: str) -> None:
    samples = image_samples(200)  # zstd gives out its data in blocks of 128 KiB
    folder = write_rosbag2(tmp_path / 'bag', samples, storage, 'file')
    path = storage_file(folder)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 3 // 4])
    got, errors = read_samples(folder)
    assert got == samples[: len(got)]
    assert len(got) > 100
    assert 'zstd data cut off' in errors[0]


@pytest.mark.parametrize('summary', [True, False])
@pytest.mark.parametrize('compression', ['zstd', 'lz4', 'none', 'bz2 of ROS 1'])
def test_corrupt_chunk_in_the_middle(tmp_path: Path, compression: str, summary: bool) -> None:
    if compression.endswith('ROS 1'):
        path = write_ros1(tmp_path / 'a.bag', SAMPLES, 'bz2')
        ends = ros1_ends(path)
    else:
        path = write_mcap(tmp_path / 'a.mcap', SAMPLES, compression, summary=summary)
        ends = mcap_ends(path)
    middle = ends[len(ends) // 2]
    kept = [s for s, end in zip(SAMPLES, ends, strict=True) if end != middle]
    content = bytearray(path.read_bytes())
    content[middle - 500] ^= 0xFF
    path.write_bytes(content)
    got, errors = read_samples(path)
    assert got == kept
    (error,) = errors
    assert 'chunk' in error
    if summary:  # only then do message indexes say how many there were
        lost = len(SAMPLES) - len(kept)
        assert f'{lost} messages lost' in error


@pytest.mark.parametrize('places', [(0,), (-1,), (0, -1)])
def test_a_damaged_definition_gives_no_wrong_name(tmp_path: Path, places: tuple[int, ...]) -> None:
    """In the first chunk, in the summary, or differently in both."""
    path = write_mcap(tmp_path / 'a.mcap', SAMPLES, 'none', chunk_size=10_000)
    content = bytearray(path.read_bytes())
    name = SAMPLES[0].topic.encode()
    starts = [found.start() for found in re.finditer(re.escape(name), content)]
    for place in places:
        content[starts[place] + 3 + place] ^= 1
    path.write_bytes(content)
    if len(places) == 2:  # nobody knows which of the two is right
        with pytest.raises(RecordingError, match='no readable topic'):
            read_samples(path)
        return
    got, errors = read_samples(path)
    assert set(got) <= set(SAMPLES)
    assert len(got) > len(SAMPLES) / 2
    assert errors


@pytest.mark.parametrize('chunk_size', [None, 10_000])
def test_damaged_record_header(tmp_path: Path, chunk_size: int | None) -> None:
    path = write_mcap(tmp_path / 'a.mcap', SAMPLES, chunk_size=chunk_size)
    ends = mcap_ends(path)
    content = bytearray(path.read_bytes())
    # The record after a message: message 11, or the first index record behind its chunk.
    start = ends[10]
    content[start : start + 9] = b'\0' * 9
    path.write_bytes(content)
    got, errors = read_samples(path)
    assert got == (SAMPLES if chunk_size else SAMPLES[:11] + SAMPLES[12:])
    assert 'damaged at byte' in errors[0]


@pytest.mark.parametrize('place', [1 << 40, (1 << 63) - 1, (1 << 64) - 1])
def test_ros1_index_that_lies_behind_the_end(tmp_path: Path, place: int) -> None:
    path = write_ros1(tmp_path / 'a.bag', SAMPLES)
    content = bytearray(path.read_bytes())
    start = content.find(b'index_pos=') + len(b'index_pos=')
    content[start : start + 8] = place.to_bytes(8, 'little')
    path.write_bytes(content)
    got, errors = read_samples(path)
    assert got == SAMPLES
    assert errors == ['a.bag: not indexed (was the recording cut off?)']


def ros1_balance(path: Path, topics: set[str] | None = None) -> tuple[int, bool]:
    """Messages lost as a pass for some topics has them, and whether that is exact."""
    with open_recording(path) as recording:
        list(recording.messages(topics))
        return recording.account.lost, recording.account.is_exact


def test_ros1_damage_counts_whichever_topics_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_ros1(tmp_path / 'a.bag', [*SAMPLES, *(string_sample(n) for n in range(9))])
    content = bytearray(path.read_bytes())
    text = content.index(b'note 4')
    content[text - 4 : text] = b'\xff\xff\0\0'  # the text's length
    path.write_bytes(content)
    assert ros1_balance(path) == (1, True)
    # What nobody wants is measured, and not converted.
    converted, convert = [], Typestore.ros1_to_cdr
    monkeypatch.setattr(
        Typestore, 'ros1_to_cdr', lambda *given: converted.append(given) or convert(*given)
    )
    assert ros1_balance(path, {SAMPLES[0].topic}) == (1, True)
    assert len(converted) == len(SAMPLES)


def test_ros1_index_that_claims_more_than_the_chunks_hold(tmp_path: Path) -> None:
    path = write_ros1(tmp_path / 'a.bag', SAMPLES)
    content = bytearray(path.read_bytes())
    for claim in (b'\x40\0\0\0', b'\0\0\1\0'):  # of the last chunk
        content[-4:] = claim
        path.write_bytes(content)
        assert ros1_balance(path) == (0, True)


@pytest.mark.parametrize('is_hidden', [False, True])
def test_ros1_index_with_a_damaged_record_leaves_the_count_known(
    tmp_path: Path, is_hidden: bool
) -> None:
    """Behind each chunk is an index of its own, and the bag's header says how many there are."""
    path = write_ros1(tmp_path / 'a.bag', SAMPLES)
    content = bytearray(path.read_bytes())
    content[content.rindex(b'op=\x06') + 3] = 0x66
    # The first message of a chunk whose index is whole.
    content[content.index(b'op=\x02') + 3] = 0x66
    if is_hidden:
        content[content.rindex(b'op=\x05') + 3] = 0x66
    path.write_bytes(content)
    lost, is_exact = ros1_balance(path)
    assert is_exact != is_hidden and lost > 0


@pytest.mark.parametrize('compression', ['none', 'bz2'])
def test_ros1_chunk_that_cannot_be_found_is_counted_by_the_index(
    tmp_path: Path, compression: str
) -> None:
    path = write_ros1(tmp_path / 'a.bag', SAMPLES, compression)
    ends = ros1_ends(path)
    content = bytearray(path.read_bytes())
    start = [match.start() for match in re.finditer(rb'op=\x05', content)][1]
    content[start : start + 4] = b'none'
    path.write_bytes(content)
    assert ros1_balance(path) == (ends.count(sorted(set(ends))[1]), True)
    # Without the index at its end nobody knows what was behind.
    path.write_bytes(content[: ends[-1]])
    assert not ros1_balance(path)[1]


def test_power_loss_that_leaves_zeros(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / 'a.mcap', SAMPLES)
    ends = mcap_ends(path)
    content = path.read_bytes()
    cut = ends[20] + 100
    path.write_bytes(content[:cut] + bytes(len(content) - cut))
    got, errors = read_samples(path)
    assert got == SAMPLES[: sum(end <= cut for end in ends)]
    assert errors


def test_damaged_pages_of_a_database(tmp_path: Path) -> None:
    path = storage_file(write_rosbag2(tmp_path / 'bag', SAMPLES, 'sqlite3'))
    with closing(sqlite3.connect(path)) as database:
        (root,) = database.execute(
            "SELECT rootpage FROM sqlite_master WHERE name = 'messages'"
        ).fetchone()
    content = bytearray(path.read_bytes())
    # Without its root page, SQLite finds no message; all rows are still on their own pages.
    content[(root - 1) * 4096 : root * 4096] = b'\xff' * 4096
    path.write_bytes(content)
    got, errors = read_samples(path)
    assert got == SAMPLES
    assert 'damaged' in errors[0]


def test_write_ahead_log_that_a_crash_left_behind(tmp_path: Path) -> None:
    path = storage_file(write_rosbag2(tmp_path / 'bag', SAMPLES[:10], 'sqlite3'))
    crashed = tmp_path / 'crashed'
    crashed.mkdir()
    with closing(sqlite3.connect(path)) as database:
        database.execute('PRAGMA journal_mode=WAL')
        for sample in SAMPLES[10:]:
            database.execute(
                'INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)',
                (sample.stamp_ns, sample.data),
            )
        database.commit()
        for suffix in ('', '-wal'):
            shutil.copy(f'{path}{suffix}', crashed)
    before = sorted(crashed.iterdir())
    assert read_samples(crashed / path.name) == (SAMPLES, [])
    assert sorted(crashed.iterdir()) == before
    # It may have happened while the log was being copied into the file.
    begun = path.read_bytes()
    left = begun[: len(begun) // 2]
    before_crash = (crashed / path.name).read_bytes()
    assert len(left) > len(before_crash)
    (crashed / path.name).write_bytes(left)
    assert read_samples(crashed / path.name) == (SAMPLES, [])
    (crashed / path.name).write_bytes(before_crash)
    (crashed / f'{path.name}-wal').unlink()
    assert len(read_samples(crashed / path.name)[0]) == 10


def test_missing_and_damaged_metadata(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / 'bag', SAMPLES)
    listed = 'rosbag2_bagfile_information: {relative_file_paths: [bag_0.mcap], files: [bag_0.mcap]}'
    (folder / 'metadata.yaml').write_text(listed)
    with open_recording(folder) as recording:
        assert recording.account.warnings == ['bag: metadata.yaml is damaged; not used']
    (folder / 'metadata.yaml').write_text('{ not yaml')
    for words in ('bag: metadata.yaml is damaged; not used', 'bag: metadata.yaml is missing'):
        # Nothing is lost by it.
        assert read_samples(folder) == (SAMPLES, [])
        with open_recording(folder) as recording:
            assert recording.account.warnings == [words]
        (folder / 'metadata.yaml').unlink(missing_ok=True)


def test_metadata_of_copies_of_copies_are_not_unfolded(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / 'bag', SAMPLES)
    listed = (folder / 'metadata.yaml').read_text()
    copies = ''.join(f'a{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}]}}\n' for i in range(1, 20))
    (folder / 'metadata.yaml').write_text(f'a0: &a0 {{x: 1}}\n{copies}{listed}')
    tracemalloc.start()
    try:
        assert read_samples(folder) == (SAMPLES, [])
        assert tracemalloc.get_traced_memory()[1] < 4_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize('is_counted', [True, False])
def test_a_missing_part_is_counted_where_the_metadata_count_it(
    tmp_path: Path, is_counted: bool
) -> None:
    folder = tmp_path / 'bag'
    with open_writer(folder, 1) as writer:
        for sample in image_samples(70):
            writer.write(*sample)
    metadata, parts = folder / 'metadata.yaml', sorted(folder.glob('*.mcap'))
    parts[1].unlink()
    if not is_counted:
        metadata.write_text(metadata.read_text().replace('  files:', '  others:'))
    with open_recording(folder) as recording:
        kept, account = sum(1 for _ in recording.messages()), recording.account
    assert len(parts) > 2 and 0 < kept < 70
    assert (account.lost, account.is_exact) == ((70 - kept, True) if is_counted else (0, False))


def test_an_empty_last_part_does_not_hide_the_others(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / 'bag_0', SAMPLES)
    (folder / 'metadata.yaml').unlink()
    (folder / 'bag_1.mcap').write_bytes(b'')
    got, errors = read_samples(folder)
    assert got == SAMPLES
    assert any('bag_1.mcap is empty' in error for error in errors)


def test_undecompressable_message_among_good_ones(tmp_path: Path) -> None:
    bad = Sample(*SAMPLES[5][:3], b'\x28\xb5\x2f\xfd' + bytes(40))
    path = write_mcap(tmp_path / 'a.mcap', [*SAMPLES[:5], bad, *SAMPLES[6:]])
    got, errors = read_samples(path)
    assert got == [*SAMPLES[:5], *SAMPLES[6:]]
    assert '1 message of /camera/image_raw cannot be decompressed' in errors[0]

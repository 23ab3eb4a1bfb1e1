"""Whole recordings of every storage and compression come back as they went in."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
import zstandard
from support.recording_samples import (
    IMAGE,
    START_NS,
    STEP_NS,
    STORE,
    TOPIC,
    Sample,
    image_samples,
    storage_file,
    string_sample,
    write_mcap,
    write_ros1,
    write_rosbag2,
)

from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.reading import Recording, open_recording

SAMPLES = [*image_samples(12), string_sample(12), *image_samples(15)[13:]]
ROSBAG2_KINDS = [
    ('mcap', 'none'),
    ('mcap', 'file'),
    ('mcap', 'message'),
    ('mcap', 'storage'),
    ('sqlite3', 'none'),
    ('sqlite3', 'file'),
    ('sqlite3', 'message'),
]


def contents(recording: Recording, **limits: int) -> list[Sample]:
    return [Sample(*message[:4]) for message in recording.messages(**limits)]


def assert_whole(path: Path, samples: list[Sample]) -> None:
    with open_recording(path) as recording:
        assert contents(recording) == samples
        assert contents(recording) == samples  # a second pass gives the same
        assert recording.account.errors == []
        assert recording.skipped == ()
        for topic in recording.topics:
            same = [sample for sample in samples if sample.topic == topic.name]
            assert topic.message_count == len(same)
            assert topic.type == same[0].type
            assert topic.schema is not None
    assert contents(recording) == samples  # closed is not empty
    recording.close()


@pytest.mark.parametrize('compression', ['zstd', 'lz4', 'none'])
@pytest.mark.parametrize('summary', [True, False])
@pytest.mark.parametrize('chunk_size', [None, 10_000])
def test_mcap_library(tmp_path: Path, compression: str, summary: bool, chunk_size: int) -> None:
    path = tmp_path / 'a.mcap'
    write_mcap(path, SAMPLES, compression, chunk_size=chunk_size, summary=summary)
    assert_whole(path, SAMPLES)


@pytest.mark.parametrize(('storage', 'compression'), ROSBAG2_KINDS)
def test_rosbag2_folder_and_its_bare_file(tmp_path: Path, storage: str, compression: str) -> None:
    folder = write_rosbag2(tmp_path / 'bag', SAMPLES, storage, compression)
    assert_whole(folder, SAMPLES)
    assert_whole(folder / 'metadata.yaml', SAMPLES)
    bare = shutil.move(storage_file(folder), tmp_path)
    assert_whole(Path(bare), SAMPLES)


@pytest.mark.parametrize('compression', ['none', 'bz2', 'lz4'])
def test_ros1_is_converted_to_cdr(tmp_path: Path, compression: str) -> None:
    path = write_ros1(tmp_path / 'a.bag', SAMPLES, compression)
    assert_whole(path, SAMPLES)
    with open_recording(path) as recording:
        topic = recording.topics[0]
        assert topic.serialization_format == 'ros1'
        assert topic.schema is not None
        # ROS 2's layout, which the bytes have: no seq in the header.
        text, _ = STORE.generate_msgdef(IMAGE, ros_version=2)
        assert topic.schema.text.replace('char', 'uint8') == text


def test_big_endian_is_passed_on_as_recorded(tmp_path: Path) -> None:
    from support.recording_samples import cdr, image

    samples = [Sample(TOPIC, IMAGE, 1, cdr(image(1), little_endian=False))]
    assert samples[0].data[1] == 0
    assert_whole(write_mcap(tmp_path / 'a.mcap', samples), samples)


def test_type_names_without_msg(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / 'a.mcap', SAMPLES, short_names=True)
    assert b'sensor_msgs/Image' in path.read_bytes()
    assert_whole(path, SAMPLES)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
@pytest.mark.parametrize('compression', ['none', 'file'])
@pytest.mark.parametrize('listed', [True, False])
def test_split_recording(tmp_path: Path, storage: str, compression: str, listed: bool) -> None:
    samples = image_samples(33)
    folder = tmp_path / 'bag'
    folder.mkdir()
    names = []
    for part in range(11):  # more than ten: bag_10 comes after bag_9
        single = write_rosbag2(
            tmp_path / f'bag_{part}', samples[3 * part : 3 * part + 3], storage, compression
        )
        names.append(shutil.move(storage_file(single), folder))
    if listed:
        text = (tmp_path / 'bag_0' / 'metadata.yaml').read_text()
        lines = ''.join(f'  - {Path(name).name}\n' for name in names)
        text, replaced = re.subn(r'(  relative_file_paths:\n)  - .*\n', rf'\1{lines}', text)
        assert replaced == 1
        (folder / 'metadata.yaml').write_text(text)
        assert_whole(folder, samples)
    with open_recording(folder) as recording:
        assert contents(recording) == samples
        assert recording.topics[0].message_count == 33
        assert recording.account.errors == []
        assert bool(recording.account.warnings) != listed


def test_time_range_and_topics(tmp_path: Path) -> None:
    first, last = START_NS + 3 * STEP_NS, START_NS + 13 * STEP_NS
    within = [sample for sample in SAMPLES if first <= sample.stamp_ns < last]
    assert 0 < len(within) < len(SAMPLES)
    paths = [
        write_mcap(tmp_path / 'a.mcap', SAMPLES),
        write_mcap(tmp_path / 'b.mcap', SAMPLES, summary=False),
        write_mcap(tmp_path / 'c.mcap', SAMPLES, chunk_size=None),
        write_rosbag2(tmp_path / 'd', SAMPLES, 'sqlite3'),
        write_ros1(tmp_path / 'e.bag', SAMPLES),
    ]
    for path in paths:
        with open_recording(path) as recording:
            assert contents(recording, start_ns=first, end_ns=last) == within
            notes = [Sample(*m[:4]) for m in recording.messages({'/note'})]
            assert notes == [s for s in SAMPLES if s.topic == '/note']
            assert recording.account.errors == []


def test_channels_that_are_not_cdr_are_skipped_and_named(tmp_path: Path) -> None:
    samples = [*SAMPLES[:3], Sample('/web', 'std_msgs/msg/String', START_NS, b'{"data": 1}')]
    path = write_mcap(tmp_path / 'a.mcap', samples, encodings={'/web': 'json'})
    with open_recording(path) as recording:
        assert [(each.name, each.encoding) for each in recording.skipped] == [('/web', 'json')]
        assert [topic.name for topic in recording.topics] == [TOPIC]
        assert contents(recording) == samples[:3]
        assert recording.account.errors == []


def test_what_is_no_recording_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / 'empty').mkdir()
    (tmp_path / 'empty.mcap').write_bytes(b'')
    (tmp_path / 'text.mcap').write_bytes(b'hello')
    (tmp_path / 'image.png').write_bytes(b'\x89PNG\r\n\x1a\n' + bytes(100))
    (tmp_path / 'old.bag').write_bytes(b'#ROSBAG V1.2\n' + bytes(100))
    (tmp_path / 'other.db3').write_bytes(b'SQLite format 3\0' + bytes(2000))
    (tmp_path / 'two').mkdir()
    write_mcap(tmp_path / 'two' / 'a.mcap', SAMPLES)
    write_mcap(tmp_path / 'two' / 'b.mcap', SAMPLES)
    for name, words in {
        'missing': 'does not exist',
        'empty': 'holds no recording',
        'empty.mcap': 'is empty',
        'text.mcap': 'is not a recording',
        'image.png': 'is not a recording',
        'old.bag': 'version 1.2',
        'other.db3': 'no readable topic',
        'two': 'give one of them: a.mcap, b.mcap',
    }.items():
        with pytest.raises(RecordingError) as refusal:
            open_recording(tmp_path / name)
        assert words in str(refusal.value)
        assert '\n' not in str(refusal.value)


@pytest.mark.parametrize('kept', [0, 20], ids=['empty', 'cut'])
def test_a_compressed_part_is_read_where_the_next_cannot_be(tmp_path: Path, kept: int) -> None:
    folder = tmp_path / 'flight'
    folder.mkdir()
    for number in (0, 1):
        part = write_mcap(tmp_path / f'flight_{number}.mcap', SAMPLES)
        (folder / f'{part.name}.zstd').write_bytes(zstandard.compress(part.read_bytes()))
    damaged = folder / 'flight_1.mcap.zstd'
    damaged.write_bytes(damaged.read_bytes()[:kept])
    with open_recording(folder) as recording:
        assert contents(recording) == SAMPLES
        assert recording.account.errors
        assert all('flight_1' in error for error in recording.account.errors)


@pytest.mark.parametrize(
    'content', [zstandard.compress(bytes(999))[:9], zstandard.compress(b'a')], ids=['cut', 'text']
)
def test_a_compressed_file_that_holds_nothing_is_named_as_it_lies(
    tmp_path: Path, content: bytes
) -> None:
    path = tmp_path / 'a.mcap.zstd'
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=rf'^{re.escape(str(path))} (was cut off|is not a)'):
        open_recording(path)

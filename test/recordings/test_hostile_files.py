"""Whatever a file claims: no traceback, no hang, and no memory but for what is honestly in it."""

from __future__ import annotations

import bz2
import json
import os
import signal
import sqlite3
import struct
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.writer import Writer as McapWriter
from support.coded_videos import HEIGHT, WIDTH, compressed_video, packets
from support.mutations import MEMORY_LIMIT, SAMPLES, TIME_LIMIT_S
from support.places import ROOT
from support.recording_samples import (
    IMAGE,
    START_NS,
    TOPIC,
    image_samples,
    storage_file,
    string_sample,
    write_mcap,
    write_ros1,
    write_rosbag2,
)

from mvuav_ros.messages.definitions import Ros1Type, UnknownTypeError
from mvuav_ros.messages.images import COMPRESSED_VIDEO, BadFrame
from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.mcap_file import CHUNK_HEADER, HEADER, MAGIC
from mvuav_ros.recordings.summary import summarise
from mvuav_ros.recordings.writing import RecordingWriter
from mvuav_ros.sources.opening import open_source
from mvuav_ros.sources.source import SourceError

DEADLINE_S = 120
"""Of a busy machine; what is read itself has `TIME_LIMIT_S`."""
ALLOWED = 256 << 20
HUGE = 5 << 28
# Saved of 3000 mutated files before the readers were bounded; the formats' libraries vary a bit.
SAVED_OF_3000 = {
    'zstd.mcap': 6180,
    'lz4.mcap': 5760,
    'plain.mcap': 6390,
    'unindexed.mcap': 6059,
    'unchunked.mcap': 10844,
    'none.bag': 10092,
    'lz4.bag': 9847,
    'bz2.bag': 5856,
    'none.db3': 9119,
    'message.db3': 9017,
    'file.db3.zstd': 6964,
    'none.mcap': 8694,
    'message.mcap': 9042,
    'file.mcap.zstd': 6345,
}
READ = """
import json, resource, signal, sys
from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.summary import summarise
from mvuav_ros.sources.opening import open_source
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[2]),) * 2)
signal.alarm(int(sys.argv[3]))
try:
    summary = summarise(sys.argv[1])
    said = [summary.messages, *summary.errors]
except RecordingError as error:
    said = [0, str(error)]
grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
print(json.dumps([grown, *said]))
"""


def python(*arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {
        **os.environ,
        'PYTHONPATH': f'{ROOT}:{ROOT / "test"}',
        'OMP_NUM_THREADS': '1',
        'OPENBLAS_NUM_THREADS': '1',
    }
    return subprocess.run(
        [sys.executable, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        timeout=DEADLINE_S * 5,
        check=False,
    )


def read(path: Path) -> tuple[int, str]:
    """The number of messages and what was said, read within the limits."""
    done = python('-c', READ, str(path), str(MEMORY_LIMIT), str(DEADLINE_S))
    assert done.returncode == 0, done.stderr[-2000:]
    grown, messages, *said = json.loads(done.stdout)
    assert grown < ALLOWED, f'{grown >> 20} MB'
    return messages, '; '.join(said)


def zeros(size: int) -> bytes:
    """A zstd frame without its size."""
    packer = zstandard.ZstdCompressor(write_content_size=False).compressobj()
    piece = bytes(1 << 22)
    return b''.join(packer.compress(piece) for _ in range(size // len(piece))) + packer.flush()


def mcap_with_chunk(path: Path, compression: str, data: bytes, size: int, crc: int = 0) -> Path:
    """A good file without an index whose last chunk is ``data``."""
    good = write_mcap(path, SAMPLES, summary=False, finish=False).read_bytes()
    name = compression.encode()
    head = CHUNK_HEADER.pack(START_NS, START_NS, size, crc, len(name)) + name
    head += struct.pack('<Q', len(data))
    path.write_bytes(good + HEADER.pack(6, len(head) + len(data)) + head + data)
    return path


@pytest.mark.parametrize(
    ('compression', 'claim'),
    [('zstd', 1000), ('zstd', (1 << 30) - 1), ('zstd', (1 << 64) - 1), ('lz4', (1 << 30) - 1)],
)
def test_chunk_of_false_size(tmp_path: Path, compression: str, claim: int) -> None:
    data = zeros(HUGE) if compression == 'zstd' else lz4.frame.compress(bytes(300 << 20))
    path = mcap_with_chunk(tmp_path / 'a.mcap', compression, data, claim)
    messages, said = read(path)
    assert messages >= len(SAMPLES) - 10  # the last chunk of the good file was never written
    assert 'skipped' in said
    assert claim < 1 << 30 or 'larger than 1 GB' in said


def test_frame_that_claims_a_false_size(tmp_path: Path) -> None:
    frame = bytearray(zstandard.ZstdCompressor().compress(bytes(1000)))
    honest = lz4.frame.compress(bytes(1000), content_checksum=False, store_size=True)
    false = bytearray(honest)
    false[6:14] = struct.pack('<Q', 1 << 40)
    for compression, data in (('zstd', frame), ('lz4', false)):
        path = mcap_with_chunk(tmp_path / 'a.mcap', compression, bytes(data), 1 << 29)
        assert 'skipped' in read(path)[1]


def test_chunk_of_wrong_size_is_read_if_its_checksum_holds(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / 'a.mcap', SAMPLES, chunk_size=1 << 24)
    content = bytearray(path.read_bytes())
    at = content.index(HEADER.pack(6, 0)[:1], len(MAGIC) + HEADER.size + 8)
    assert content[at] == 6
    struct.pack_into('<Q', content, at + HEADER.size + 16, 12345)
    path.write_bytes(content)
    messages, _ = read(path)
    assert messages == len(SAMPLES)


@pytest.mark.parametrize('empty', [lz4.frame.compress(b''), struct.pack('<II', 0x184D2A50, 0)])
def test_chunk_of_very_many_empty_frames(tmp_path: Path, empty: bytes) -> None:
    compression = 'lz4' if empty[0] == 4 else 'zstd'
    path = mcap_with_chunk(tmp_path / 'a.mcap', compression, empty * 200_000, (1 << 30) - 1)
    start = time.process_time()
    assert 'too many pieces' in '; '.join(summarise(path).errors)
    assert time.process_time() - start < TIME_LIMIT_S


@pytest.mark.parametrize('opcode', [3, 4])
def test_definition_of_most_of_a_gigabyte(tmp_path: Path, opcode: int) -> None:
    path = write_mcap(tmp_path / 'a.mcap', SAMPLES, summary=False, chunk_size=None, finish=False)
    size = 900 << 20
    with path.open('ab') as stream:
        body = stream.tell() + stream.write(HEADER.pack(opcode, size))
        stream.truncate(body + size)  # on disk there is nothing of it
    messages, said = read(path)
    assert messages == len(SAMPLES)
    assert f'definition at byte {body} skipped' in said


def test_video_packet_that_claims_hundreds_of_megapixels(tmp_path: Path) -> None:
    data = bytearray(packets('libvpx', 1)[0])
    assert struct.unpack_from('<HH', data, 6) == (WIDTH, HEIGHT)
    struct.pack_into('<HH', data, 6, 0x3FFF, 0x3FFF)
    path = tmp_path / 'a.mcap'
    with RecordingWriter(path) as writer:
        for number in range(4):
            message = compressed_video(bytes(data), 'vp8', START_NS + number)
            writer.write('/video', COMPRESSED_VIDEO, START_NS + number, message)
    assert read(path)[0] == 4
    (topic,) = summarise(path).topics
    frames = list(open_source(str(path)).frames())
    assert topic.images is not None and topic.images.malformed == len(frames) == 4
    assert all(isinstance(frame, BadFrame) for frame in frames)
    assert topic.images.first_problem == frames[0].reason
    assert 'too large' in frames[0].reason


def test_summary_that_begins_at_the_beginning(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / 'a.mcap', SAMPLES)
    content = bytearray(path.read_bytes())
    struct.pack_into('<QQI', content, len(content) - len(MAGIC) - 20, len(MAGIC), 0, 0)
    path.write_bytes(content)
    assert read(path)[0] == len(SAMPLES)


def test_bz2_of_ros1(tmp_path: Path) -> None:
    path = write_ros1(tmp_path / 'a.bag', SAMPLES, 'bz2', chunk_size=1 << 24)
    content = path.read_bytes()
    bomb = bz2.compress(bytes(1 << 26)) * 40
    start = content.index(b'BZh')
    size_at = start - 4
    (size,) = struct.unpack_from('<I', content, size_at)
    path.write_bytes(
        content[:size_at] + struct.pack('<I', len(bomb)) + bomb + content[start + size :]
    )
    assert 'skipped' in read(path)[1]


@pytest.mark.parametrize(
    'definition',
    [
        'b/B[] x\n' + '=' * 80 + '\nMSG: b/B\n',
        'a/A y\n',
        'string[2000000000] x\n',
        ''.join(f'b/B{n} x\nb/B{n} y\n{"=" * 80}\nMSG: b/B{n}\n' for n in range(40)) + 'uint8 x\n',
        ''.join(f'b/B{n} x\n{"=" * 80}\nMSG: b/B{n}\n' for n in range(1200)) + 'uint8 x\n',
    ],
    ids=['nothing', 'itself', 'strings', 'doubling', 'chain'],
)
def test_definitions_that_never_end(definition: str) -> None:
    with pytest.raises(UnknownTypeError):
        Ros1Type('a/msg/A', definition)


def _varint(value: int) -> bytes:
    if value >= 1 << 56:
        raise ValueError(value)
    groups = [value & 0x7F]
    while value := value >> 7:
        groups.insert(0, (value & 0x7F) | 0x80)
    return bytes(groups)


@pytest.mark.parametrize('size', [1 << 20, 1 << 50])
def test_overflow_page_that_points_at_itself(tmp_path: Path, size: int) -> None:
    path = storage_file(write_rosbag2(tmp_path / 'bag', image_samples(200), 'sqlite3'))
    content = bytearray(path.read_bytes())
    (page_size,) = struct.unpack_from('>H', content, 16)
    count = len(content) // page_size
    header = bytes([0, 1, 6]) + _varint(2 * size + 12)
    header = bytes([len(header) + 1]) + header
    payload = header + bytes([1]) + struct.pack('>q', START_NS)
    cell = _varint(len(payload) + size) + _varint(10_000) + payload + bytes(page_size)
    for number in (count - 2, count - 1):
        page = bytearray(struct.pack('>BHHHB', 13, 0, 200, 16 + 400, 0))
        page += struct.pack('>H', 600) * 200
        page = page.ljust(600, b'\0') + cell
        page = page[: page_size - 4] + struct.pack('>I', number + 1)
        # Its first four bytes are the pointer to the next overflow page: itself.
        content[number * page_size : (number + 1) * page_size] = page
    overflow = struct.pack('>I', count - 3)
    content[(count - 4) * page_size : (count - 4) * page_size + 4] = overflow
    path.write_bytes(content)
    messages, _ = read(path)
    assert messages > 100


@pytest.mark.parametrize('table', ['topics', 'messages'])
def test_endless_view_instead_of_a_table(tmp_path: Path, table: str) -> None:
    path = storage_file(write_rosbag2(tmp_path / 'bag', SAMPLES, 'sqlite3'))
    columns = {
        'topics': "n AS id, '/t' || n AS name, 'a/msg/A' AS type, 'cdr' AS serialization_format",
        'messages': 'n AS id, 1 AS topic_id, n AS timestamp, zeroblob(100000) AS data',
    }[table]
    with closing(sqlite3.connect(path)) as database:
        database.execute(f'ALTER TABLE {table} RENAME TO old')
        database.execute(
            f'CREATE VIEW {table} AS WITH RECURSIVE c(n) AS '
            f'(SELECT 1 UNION ALL SELECT n + 1 FROM c) SELECT {columns} FROM c'
        )
        database.commit()
    assert 'views' in read(path)[1]


def test_message_that_becomes_gigabytes(tmp_path: Path) -> None:
    bad = SAMPLES[5]._replace(data=zeros(HUGE))
    path = write_mcap(tmp_path / 'a.mcap', [*SAMPLES[:5], bad, *SAMPLES[6:]])
    messages, said = read(path)
    assert messages == len(SAMPLES) - 1
    assert '1 message of' in said


def test_log_time_at_the_end_of_a_databases_time(tmp_path: Path) -> None:
    late = SAMPLES[-1]._replace(stamp_ns=(1 << 63) - 1)
    folder = write_rosbag2(tmp_path / 'bag', [*SAMPLES, late], 'sqlite3')
    assert read(folder)[0] == len(SAMPLES) + 1


def test_log_time_at_the_end_of_time(tmp_path: Path) -> None:
    late = SAMPLES[-1]._replace(stamp_ns=(1 << 64) - 1)
    path = write_mcap(tmp_path / 'a.mcap', [SAMPLES[0]._replace(stamp_ns=0), *SAMPLES, late])
    assert read(path)[0] == len(SAMPLES) + 2


def test_index_that_lacks_a_type_of_a_topic(tmp_path: Path) -> None:
    whole = write_mcap(tmp_path / 'a.mcap', SAMPLES).read_bytes()
    path = tmp_path / 'two.mcap'
    path.write_bytes(whole)
    content = bytearray(whole)
    # The summary's channel of /note becomes a private record, which readers skip.
    at = content.rindex(b'/note') - 8 - HEADER.size
    assert content[at] == 4
    content[at] = 0x90
    footer = len(content) - len(MAGIC) - 4
    struct.pack_into('<I', content, footer, 0)
    path.write_bytes(content)
    assert read(path)[0] == len(SAMPLES)


@pytest.mark.parametrize('second', [IMAGE, 'std_msgs/msg/String'])
def test_index_that_lacks_one_of_two_channels_of_a_topic(tmp_path: Path, second: str) -> None:
    path = tmp_path / 'a.mcap'
    with path.open('wb') as stream:
        writer = McapWriter(stream)
        writer.start('ros2', 'test')
        schemas = [writer.register_schema(kind, '', b'') for kind in (IMAGE, second)]
        channels = [
            writer.register_channel(TOPIC, 'cdr', schema, {'number': str(number)})
            for number, schema in enumerate(schemas)
        ]
        for number, sample in enumerate(image_samples(10)):
            data = sample.data if number % 2 == 0 or second == IMAGE else string_sample(1).data
            writer.add_message(channels[number % 2], sample.stamp_ns, data, sample.stamp_ns)
        writer.finish()
    content = bytearray(path.read_bytes())
    at = content.rindex(TOPIC.encode()) - 8 - HEADER.size
    assert content[at] == 4
    content[at] = 0x90
    struct.pack_into('<I', content, len(content) - len(MAGIC) - 4, 0)
    path.write_bytes(content)
    assert read(path)[0] == 10
    assert len(list(open_source(str(path)).frames())) == (10 if second == IMAGE else 5)


@pytest.mark.parametrize('name', ['a.mcap', 'a.db3.zstd', 'pipe', 'a.mp4', 'a.png'])
def test_a_pipe_does_not_hang(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    source = str(tmp_path / name)
    signal.alarm(DEADLINE_S)  # ends the test run: better than waiting for ever
    for look in (summarise, open_source):
        with pytest.raises((RecordingError, SourceError), match='neither a file nor a folder'):
            look(source)
    signal.alarm(0)


def test_a_pipe_in_a_folder_does_not_hang(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / 'bag', SAMPLES)
    (folder / 'metadata.yaml').unlink()
    os.mkfifo(folder / 'metadata.yaml')
    os.mkfifo(folder / 'other')
    assert read(folder)[0] == len(SAMPLES)


@pytest.mark.parametrize('log', ['-wal', '-journal'])
def test_a_pipe_in_place_of_a_databases_log_does_not_hang(tmp_path: Path, log: str) -> None:
    path = storage_file(write_rosbag2(tmp_path / 'bag', SAMPLES, 'sqlite3'))
    os.mkfifo(f'{path}{log}')
    messages, said = read(path)
    assert messages == len(SAMPLES)
    assert 'the log beside it is no file' in said


def test_a_few_mutations() -> None:
    assert_mutations_are_survived(20_000, 20_140)


@pytest.mark.long
def test_many_mutations() -> None:
    saved = assert_mutations_are_survived(0, 3000)
    for kind, before in SAVED_OF_3000.items():
        assert saved[kind] >= 0.98 * before, kind
    assert sum(saved.values()) >= 0.995 * sum(SAVED_OF_3000.values())


def assert_mutations_are_survived(first: int, last: int) -> dict[str, int]:
    """Each within `MEMORY_LIMIT` and `TIME_LIMIT_S`; the seed that is not is in the message."""
    assert TIME_LIMIT_S <= 10
    done = python('-m', 'support.mutations', str(first), str(last))
    print(f'seeds {first} to {last}: {done.stdout}')
    assert done.returncode == 0, done.stderr[-2000:]
    assert 'Traceback' not in done.stderr
    saved: dict[str, int] = json.loads(done.stdout)
    assert sum(saved.values()) > (last - first) * len(SAMPLES) / 3
    return saved

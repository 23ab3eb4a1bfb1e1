"""Recordings that were made to lose, forge, hide or fill something, and what is in them.

Each is made anew; together they are the corpus that every command has to survive.
"""

from __future__ import annotations

import sqlite3
import struct
import zlib
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import numpy as np
import zstandard
from mcap._chunk_builder import ChunkBuilder
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, Message, Schema
from mcap.writer import Writer as McapWriter

from mvuav_ros.recordings.mcap_file import HEADER, MAGIC
from mvuav_ros.recordings.writing import RecordingWriter, record_bytes
from support.recording_samples import (
    IMAGE,
    START_NS,
    STEP_NS,
    STORE,
    TOPIC,
    Sample,
    cdr,
    image_samples,
    mcap_ends,
    storage_file,
    string_sample,
    write_mcap,
    write_ros1,
    write_rosbag2,
)

CLOUD = 'sensor_msgs/msg/PointCloud2'
STRING = 'std_msgs/msg/String'
EVIL = '/\x1b]0;owned\x07\x1b[2J\x9b31m\u202egpj\u200b\nmvuav: all is well\x00'
SAMPLES = [*image_samples(20), *(string_sample(n) for n in range(20))]
SAMPLES.sort(key=lambda sample: sample.stamp_ns)


class Known(NamedTuple):
    """A recording; of its ``written`` messages so many must be ``kept``, None: nobody knows."""

    path: Path
    written: int | None
    kept: int | None


def cloud(fields: list[tuple[str, int, int]], step: int, data: bytes) -> bytes:
    """A PointCloud2 in CDR; its fields are name, offset and datatype."""
    types = STORE.types
    header = types['std_msgs/msg/Header'](types['builtin_interfaces/msg/Time'](1, 0), 'camera')
    made = [types['sensor_msgs/msg/PointField'](*field, 1) for field in fields]
    pixels = np.frombuffer(data, np.uint8)
    count = len(data) // max(step, 1)
    return cdr(types[CLOUD](header, 1, count, made, False, step, len(data), pixels, True))


GOOD_CLOUD = cloud([('x', 0, 7), ('y', 4, 7)], 8, bytes(16))


def write_clouds(path: Path, *clouds: bytes) -> Path:
    """A recording of clouds on one topic."""
    with RecordingWriter(path) as writer:
        for number, data in enumerate(clouds):
            writer.write('/cloud', CLOUD, START_NS + number, data)
    return path


def overlapping_cloud(folder: Path) -> Known:
    """Some hundred bytes whose fields lie over each other: 600 million values."""
    fields = [(f'f{n}', 0, 2) for n in range(200)]
    bad = cloud(fields, 1, bytes(3_000_000))
    return Known(write_clouds(folder / 'a.mcap', GOOD_CLOUD, bad, GOOD_CLOUD), 3, 3)


def far_cloud(folder: Path) -> Known:
    """An offset beyond the data."""
    bad = cloud([('x', 0xFFFF_FFFF, 7)], 8, bytes(16))
    return Known(write_clouds(folder / 'a.mcap', GOOD_CLOUD, bad, GOOD_CLOUD), 3, 3)


def joined(folder: Path) -> Known:
    """Two files in one, whose channels of one number are different topics."""
    return Known(_joined(folder / 'joined.mcap', write_mcap), 30, 30)


def joined_ros1(folder: Path) -> Known:
    """The same of ROS 1."""
    return Known(_joined(folder / 'joined.bag', write_ros1), None, 30)


def _joined(path: Path, write: Callable[[Path, Sequence[Sample]], Path]) -> Path:
    content = b''
    for samples in (image_samples(20), [string_sample(n) for n in range(10)]):
        content += write(path, samples).read_bytes()
        path.unlink()
    path.write_bytes(content)
    return path


def odd_rows(folder: Path) -> Known:
    """Rows with data that are text or missing, times that are none, and topics of nobody."""
    path = storage_file(write_rosbag2(folder / 'bag', SAMPLES, 'sqlite3')).rename(folder / 'a.db3')
    data = SAMPLES[0].data
    with closing(sqlite3.connect(path)) as database:
        for topic, stamp, content in (
            *((1, START_NS, 'text'), (1, START_NS, None), (1, START_NS, 5), (1, 1.5, data)),
            *((1, 'soon', data), (1, None, data), (99, START_NS, data), ('a', START_NS, data)),
        ):
            query = 'INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)'
            try:
                database.execute(query, (topic, stamp, content))
            except sqlite3.IntegrityError:  # rosbags declares columns NOT NULL
                database.execute(query, (99, START_NS, data))
        database.commit()
    return Known(path, len(SAMPLES) + 8, len(SAMPLES))


def view_with_a_tab(folder: Path) -> Known:
    """An endless view whose definition is not spelt as usual."""
    path = storage_file(write_rosbag2(folder / 'bag', SAMPLES[:2], 'sqlite3'))
    with closing(sqlite3.connect(path)) as database:
        database.execute('ALTER TABLE messages RENAME TO old')
        database.execute(
            'CREATE\tVIEW\tmessages AS WITH RECURSIVE c(n) AS '
            '(SELECT 1 UNION ALL SELECT n + 1 FROM c) '
            'SELECT n AS id, 1 AS topic_id, n AS timestamp, zeroblob(100000) AS data FROM c'
        )
        database.commit()
    return Known(path, None, 0)


def evil_names(folder: Path) -> Known:
    """Control sequences in every text that a recording has."""
    path = folder / f'a{EVIL.replace("/", "").replace(chr(0), "")}.mcap'
    with path.open('wb') as stream:
        writer = McapWriter(stream)
        writer.start('ros2', 'test')
        for number, (topic, kind, encoding, data) in enumerate(
            [
                (EVIL, IMAGE, 'cdr', SAMPLES[0].data),
                (f'{EVIL}2', 'geometry_msgs/msg/PoseStamped', 'cdr', b'\0\1\0\0'),
                (f'{EVIL}3', f'a/msg/{EVIL}', 'cdr', b''),
                (f'{EVIL}4', IMAGE, f'json{EVIL}', b''),
            ]
        ):
            schema = writer.register_schema(kind, 'ros2msg', b'')
            channel = writer.register_channel(topic, encoding, schema)
            writer.add_message(channel, START_NS + number, data, START_NS + number)
        writer.finish()
    return Known(path, 4, 3)


def _mcap(path: Path, chunks: list[list[object]], times: tuple[int, int] | None = None) -> Path:
    """A file without a summary of chunks with these records and indexes."""
    content = RecordBuilder()
    content.write(MAGIC)
    Header('ros2', 'test').write(content)
    for records in chunks:
        chunk = ChunkBuilder()
        for record in records:
            if isinstance(record, Message):
                chunk.add_message(record)
            elif isinstance(record, bytes):
                chunk.record_writer.write(record)
            else:
                record.write(chunk.record_writer)
        data = chunk.end()
        start_ns, end_ns = times or (chunk.message_start_time, chunk.message_end_time)
        packed = zstandard.compress(data)
        Chunk('zstd', packed, end_ns, start_ns, zlib.crc32(data), len(data)).write(content)
        for index in chunk.message_indices.values():
            index.write(content)
    path.write_bytes(content.end())
    return path


def _message(channel: int, sample: Sample) -> Message:
    times = {'log_time': sample.stamp_ns, 'publish_time': sample.stamp_ns}
    return Message(channel_id=channel, data=sample.data, sequence=0, **times)


def _channel(number: int, sample: Sample) -> list[object]:
    text, _ = STORE.generate_msgdef(sample.type, ros_version=2)
    schema = Schema(data=text.encode(), encoding='ros2msg', id=number, name=sample.type)
    channel = Channel(
        id=number, topic=sample.topic, message_encoding='cdr', metadata={}, schema_id=number
    )
    return [schema, channel]


def channel_defined_again(folder: Path) -> Known:
    """One number for two topics, one after the other."""
    images, notes = image_samples(5), [string_sample(n) for n in range(5)]
    first = [*_channel(1, images[0]), *(_message(1, sample) for sample in images)]
    second = [*_channel(1, notes[0]), *(_message(1, sample) for sample in notes)]
    return Known(_mcap(folder / 'a.mcap', [first, second]), None, 10)


def lying_summary(folder: Path) -> Known:
    """A summary that calls the topic otherwise than the data."""
    path = write_mcap(folder / 'a.mcap', image_samples(20))
    content = bytearray(path.read_bytes())
    at = content.rindex(TOPIC.encode())
    content[at : at + len(TOPIC)] = b'/forged'.ljust(len(TOPIC), b'_')
    footer = len(content) - len(MAGIC) - 20 - HEADER.size
    (start,) = struct.unpack_from('<Q', content, footer + HEADER.size)
    checksum = zlib.crc32(content[start : len(content) - len(MAGIC) - 4])
    struct.pack_into('<I', content, len(content) - len(MAGIC) - 4, checksum)
    path.write_bytes(content)
    return Known(path, 20, 20)


def lying_ros1_index(folder: Path) -> Known:
    """The same of ROS 1."""
    path = write_ros1(folder / 'a.bag', image_samples(20))
    content = bytearray(path.read_bytes())
    at = content.rindex(TOPIC.encode())
    while at > len(content) // 2:  # in the header and in the data of the index's record
        content[at : at + len(TOPIC)] = b'/forged'.ljust(len(TOPIC), b'_')
        following = content.rfind(TOPIC.encode())
        if following < len(content) - 6000:
            break
        at = following
    path.write_bytes(content)
    return Known(path, None, 20)


def lying_times(folder: Path) -> Known:
    """Chunks whose headers say another time than their messages."""
    path = write_mcap(folder / 'a.mcap', image_samples(30))
    content = bytearray(path.read_bytes())
    for end in sorted(set(mcap_ends(path))):
        start = content.rfind(b'\x06', 0, end)
        while start > 0:
            (length,) = struct.unpack_from('<Q', content, start + 1)
            if start + HEADER.size + length == end:
                struct.pack_into('<QQ', content, start + HEADER.size, 1, 2)
                break
            start = content.rfind(b'\x06', 0, start)
    path.write_bytes(content)
    return Known(path, 30, 30)


def zero_in_a_chunk(folder: Path) -> Known:
    """A record of kind 0 in the middle of a chunk, behind which messages are."""
    images = image_samples(6)
    records = [*_channel(1, images[0]), *(_message(1, sample) for sample in images[:3])]
    path = _mcap(folder / 'a.mcap', [[*records, bytes(9), *(_message(1, s) for s in images[3:])]])
    end = b''.join(map(record_bytes, (DataEnd(0), Footer(0, 0, 0))))
    path.write_bytes(path.read_bytes() + end + MAGIC)
    return Known(path, 6, 3)


def zstd_bomb(folder: Path) -> Known:
    """200 kB that become 6 GB."""
    packer = zstandard.ZstdCompressor(write_content_size=False).compressobj()
    start = write_mcap(folder / 'a.mcap', image_samples(5), summary=False, finish=False)
    data = packer.compress(start.read_bytes() + HEADER.pack(0x90, 6 << 30))
    start.unlink()
    piece = bytes(1 << 24)
    path = folder / 'a.mcap.zstd'
    with path.open('wb') as stream:
        stream.write(data)
        for _ in range((6 << 30) // len(piece)):
            stream.write(packer.compress(piece))
        stream.write(packer.flush())
    return Known(path, None, None)


def chunk_bombs(folder: Path) -> Known:
    """Forty honest chunks of 256 MB in a small file."""
    notes = [string_sample(n) for n in range(3)]
    huge = Sample('/note', STRING, START_NS, bytes(1 << 28))
    first = [*_channel(1, notes[0]), *(_message(1, sample) for sample in notes)]
    path = _mcap(folder / 'a.mcap', [first, [_message(1, huge)]])
    content = path.read_bytes()
    at = content.index(b'\x06', len(_mcap(folder / 'b.mcap', [first]).read_bytes()) - 1)
    (folder / 'b.mcap').unlink()
    path.write_bytes(content[:at] + content[at:] * 40)
    return Known(path, None, None)


def many_topics(folder: Path) -> Known:
    """As many channels as there are numbers for."""
    path = folder / 'a.mcap'
    with path.open('wb') as stream:
        writer = McapWriter(stream)
        writer.start('ros2', 'test')
        schema = writer.register_schema('geometry_msgs/msg/PoseStamped', 'ros2msg', b'')
        for number in range(65_000):
            channel = writer.register_channel(f'/t{number}', 'cdr', schema)
            writer.add_message(channel, START_NS + number, b'\0\1\0\0', START_NS)
        writer.finish()
    return Known(path, 65_000, 65_000)


def undecodable_results(folder: Path) -> Known:
    """Results of which two thirds are no messages, in two kinds of one topic."""
    path = folder / 'a.mcap'
    with RecordingWriter(path) as writer:
        for number in range(12):
            data = GOOD_CLOUD if number % 3 == 0 else b'\0\1\0\0damage'
            kind = CLOUD if number % 2 else 'geometry_msgs/msg/PoseStamped'
            writer.write('/markers', kind, START_NS + number * STEP_NS, data)
    return Known(path, 12, 12)


def early_times(folder: Path) -> Known:
    """Messages from before 1970."""
    samples = [sample._replace(stamp_ns=n - 10) for n, sample in enumerate(image_samples(20))]
    folder.mkdir(exist_ok=True)
    return Known(write_rosbag2(folder / 'bag', samples, 'sqlite3'), 20, 20)


CORPUS: tuple[Callable[[Path], Known], ...] = (
    *(overlapping_cloud, far_cloud, joined, joined_ros1, odd_rows, view_with_a_tab, evil_names),
    *(channel_defined_again, lying_summary, lying_ros1_index, lying_times, zero_in_a_chunk),
    *(zstd_bomb, chunk_bombs, many_topics, undecodable_results, early_times),
)

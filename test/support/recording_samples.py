"""Recordings of every kind, written by rosbags and mcap for the tests."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_typestore

IMAGE = 'sensor_msgs/msg/Image'
TOPIC = '/camera/image_raw'
STORE = get_typestore(Stores.ROS2_JAZZY)
ROS1_STORE = get_typestore(Stores.ROS1_NOETIC)
START_NS = 1_700_000_000_000_000_000
STEP_NS = 33_333_333


class Sample(NamedTuple):
    """A message as it goes in, and should come out."""

    topic: str
    type: str
    stamp_ns: int
    data: bytes


def image(number: int, width: int = 64, height: int = 48, *, noisy: bool = True) -> Any:
    """An Image object unlike any with another number; noise does not compress."""
    types = STORE.types
    random = np.random.default_rng(number)
    pixels = random.integers(0, 256, width * height, np.uint8)
    if not noisy:
        pixels = np.full(width * height, number % 256, np.uint8)
    stamp_ns = START_NS + number * STEP_NS
    stamp = types['builtin_interfaces/msg/Time'](stamp_ns // 10**9, stamp_ns % 10**9)
    header = types['std_msgs/msg/Header'](stamp, f'camera {number}')
    return types[IMAGE](header, height, width, 'mono8', 0, width, pixels)


def cdr(message: Any, *, little_endian: bool = True) -> bytes:
    return bytes(STORE.serialize_cdr(message, message.__msgtype__, little_endian=little_endian))


def image_samples(count: int, width: int = 64, height: int = 48) -> list[Sample]:
    return [
        Sample(TOPIC, IMAGE, START_NS + n * STEP_NS, cdr(image(n, width, height)))
        for n in range(count)
    ]


def string_sample(number: int, topic: str = '/note') -> Sample:
    message = STORE.types['std_msgs/msg/String'](f'note {number}')
    return Sample(topic, 'std_msgs/msg/String', START_NS + number * STEP_NS, cdr(message))


def pose_sample(number: int, topic: str = '/pose') -> Sample:
    types = STORE.types
    stamp_ns = START_NS + number * STEP_NS
    stamp = types['builtin_interfaces/msg/Time'](stamp_ns // 10**9, stamp_ns % 10**9)
    header = types['std_msgs/msg/Header'](stamp, 'camera')
    place = types['geometry_msgs/msg/Point'](float(number), 2.0, 3.0)
    turn = types['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0)
    kind = 'geometry_msgs/msg/PoseStamped'
    pose = types[kind](header, types['geometry_msgs/msg/Pose'](place, turn))
    return Sample(topic, kind, stamp_ns, cdr(pose))


def write_mcap(
    path: Path,
    samples: Sequence[Sample],
    compression: str = 'zstd',
    *,
    chunk_size: int | None = 10_000,
    encodings: dict[str, str] | None = None,
    short_names: bool = False,
    finish: bool = True,
    summary: bool = True,
) -> Path:
    """A file by the mcap library; ``chunk_size`` None means without chunks."""
    with path.open('wb') as stream:
        writer = McapWriter(
            stream,
            chunk_size=chunk_size or 0,
            compression=CompressionType[compression.upper()],
            use_chunking=chunk_size is not None,
            index_types=IndexType.ALL if summary else IndexType.NONE,
            repeat_channels=summary,
            repeat_schemas=summary,
            use_statistics=summary,
            use_summary_offsets=summary,
        )
        writer.start('ros2', 'test')
        channels: dict[str, int] = {}
        for sample in samples:
            if sample.topic not in channels:
                text, _ = STORE.generate_msgdef(sample.type, ros_version=2)
                name = sample.type.replace('/msg/', '/') if short_names else sample.type
                schema = writer.register_schema(name, 'ros2msg', text.encode())
                encoding = (encodings or {}).get(sample.topic, 'cdr')
                channels[sample.topic] = writer.register_channel(sample.topic, encoding, schema)
            writer.add_message(
                channels[sample.topic], sample.stamp_ns, sample.data, sample.stamp_ns
            )
        if finish:
            writer.finish()
    return path


def write_rosbag2(
    folder: Path,
    samples: Sequence[Sample],
    storage: str = 'mcap',
    compression: str = 'none',
) -> Path:
    """A folder by rosbags; ``compression`` is rosbag2's mode: none, file, message, storage."""
    writer = rosbag2.Writer(folder, version=9, storage_plugin=StoragePlugin[storage.upper()])
    writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with writer:
        connections = {sample.topic: None for sample in samples}
        for sample in samples:
            if connections[sample.topic] is None:
                connections[sample.topic] = writer.add_connection(
                    sample.topic, sample.type, typestore=STORE
                )
            writer.write(connections[sample.topic], sample.stamp_ns, sample.data)
    return folder


def storage_file(folder: Path) -> Path:
    """The one file of a rosbag2 folder beside its metadata.yaml."""
    (found,) = (entry for entry in folder.iterdir() if entry.name != 'metadata.yaml')
    return found


def write_ros1(
    path: Path, samples: Sequence[Sample], compression: str = 'none', chunk_size: int = 10_000
) -> Path:
    """A ROS 1 bag by rosbags of the same messages."""
    writer = rosbag1.Writer(path)
    if compression != 'none':
        writer.set_compression(rosbag1.Writer.CompressionFormat[compression.upper()])
    writer.chunk_threshold = chunk_size
    with writer:
        connections = {}
        for sample in samples:
            if sample.topic not in connections:
                connections[sample.topic] = writer.add_connection(
                    sample.topic, sample.type, typestore=ROS1_STORE
                )
            raw = STORE.cdr_to_ros1(sample.data, sample.type)
            writer.write(connections[sample.topic], sample.stamp_ns, raw)
    return path


def mcap_ends(path: Path) -> list[int]:
    """For each message, where the record ends that holds it: its chunk or itself."""
    ends: list[int] = []
    stream = BytesIO(path.read_bytes())  # a file would be buffered: tell() be too far
    for record in StreamReader(stream, emit_chunks=True).records:
        if isinstance(record, Chunk):
            messages = [r for r in breakup_chunk(record) if isinstance(r, Message)]
            ends += [stream.tell()] * len(messages)
        elif isinstance(record, Message):
            ends.append(stream.tell())
    return ends


def ros1_ends(path: Path) -> list[int]:
    """For each message, where its chunk ends."""
    ends: list[int] = []
    with rosbag1.Reader(path) as reader:
        for info in reader.chunk_infos:
            chunk = reader.chunks[info.pos]
            ends += [chunk.datapos + chunk.datasize] * sum(info.connection_counts.values())
    return ends


def sqlite_ends(path: Path, samples: Sequence[Sample], page_size: int = 4096) -> list[int]:
    """For each message, the end of the last page that holds any of its (random) bytes."""
    content = path.read_bytes()
    ends: list[int] = []
    for sample in samples:
        pieces = [sample.data[n : n + 48] for n in range(64, len(sample.data) - 48, 96)]
        # A piece that is split between two pages is not found; its neighbours are.
        found = max(content.find(piece) for piece in [*pieces, sample.data[-24:]])
        assert found > 0
        ends.append((found // page_size + 1) * page_size)
    return ends

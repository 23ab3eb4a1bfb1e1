"""Recordings as they are met with: empty, unfinished, under any name, of ROS 1 inside mcap."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.writer import Writer as McapWriter
from support.coded_videos import compressed_image
from support.recording_samples import (
    IMAGE,
    ROS1_STORE,
    START_NS,
    STORE,
    TOPIC,
    Sample,
    cdr,
    image,
    image_samples,
    storage_file,
    write_mcap,
    write_ros1,
    write_rosbag2,
)

from mvuav_ros.messages.images import BadFrame, Frame
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.summary import summarise
from mvuav_ros.recordings.writing import RecordingWriter
from mvuav_ros.sources.bag import BagImages
from mvuav_ros.sources.opening import looks_like_bag, open_source
from mvuav_ros.sources.source import SourceError

SAMPLES = image_samples(6)
COMPRESSED_IMAGE = 'sensor_msgs/msg/CompressedImage'


def images_in(path: Path) -> int:
    """Frames of whatever is there, which `mvuav info` must count as well."""
    frames = list(open_source(str(path), cameras=False).frames())
    assert all(isinstance(frame, Frame) for frame in frames)
    summary = summarise(path)
    assert summary.messages == len(frames)
    assert summary.errors == []
    return len(frames)


def ros1_in_mcap(path: Path, definition: str | None = None) -> Path:
    with path.open('wb') as stream:
        writer = McapWriter(stream)
        writer.start('ros1', 'test')
        text, _ = ROS1_STORE.generate_msgdef('sensor_msgs/msg/Image', ros_version=1)
        text = text if definition is None else definition
        schema = writer.register_schema('sensor_msgs/Image', 'ros1msg', text.encode())
        channel = writer.register_channel(TOPIC, 'ros1', schema)
        for sample in SAMPLES:
            data = bytes(STORE.cdr_to_ros1(sample.data, sample.type))
            writer.add_message(channel, sample.stamp_ns, data, sample.stamp_ns)
        writer.finish()
    return path


def test_ros1_messages_in_mcap(tmp_path: Path) -> None:
    path = ros1_in_mcap(tmp_path / 'a.mcap')
    with open_recording(path) as recording:
        assert [Sample(*message[:4]) for message in recording.messages()] == SAMPLES
    assert images_in(path) == len(SAMPLES)


def test_ros1_messages_in_mcap_without_their_definition(tmp_path: Path) -> None:
    path = ros1_in_mcap(tmp_path / 'a.mcap', 'nonsense')
    assert 'without a valid definition' in summarise(path).skipped[0].encoding
    with pytest.raises(SourceError, match='without a valid definition'):
        open_source(str(path))


@pytest.mark.parametrize('kind', ['a.mcap', 'bag', 'a.bag', 'ours.mcap'])
def test_valid_empty_bags(tmp_path: Path, kind: str) -> None:
    path = tmp_path / kind
    if kind == 'a.mcap':
        write_mcap(path, [])
    elif kind == 'bag':
        write_rosbag2(path, [], 'sqlite3')
    elif kind == 'a.bag':
        write_ros1(path, [])
    else:
        RecordingWriter(path).close()
    summary = summarise(path)
    assert (summary.messages, summary.errors) == (0, [])
    with pytest.raises(SourceError, match='is empty: nothing was recorded in it'):
        open_source(str(path))


def test_database_without_a_serialization_format(tmp_path: Path) -> None:
    path = storage_file(write_rosbag2(tmp_path / 'bag', SAMPLES, 'sqlite3'))
    with closing(sqlite3.connect(path)) as database:
        database.execute('ALTER TABLE topics DROP COLUMN serialization_format')
        database.commit()
    assert images_in(path) == len(SAMPLES)


@pytest.mark.parametrize('name', ['a.mcap.active', 'a', 'a.mp4', 'a.bag', 'a.png', 'a.backup.1'])
@pytest.mark.parametrize('write', [write_mcap, write_ros1])
def test_content_decides_and_not_the_name(
    tmp_path: Path, write: Callable[..., Path], name: str
) -> None:
    path = write(tmp_path / 'made', SAMPLES).rename(tmp_path / name)
    assert looks_like_bag(path)
    assert images_in(path) == len(SAMPLES)


@pytest.mark.parametrize('name', ['a.mcap.active', 'other'])
def test_a_folder_whose_recording_was_never_renamed(tmp_path: Path, name: str) -> None:
    folder = tmp_path / 'bag'
    folder.mkdir()
    write_mcap(folder / name, SAMPLES)
    assert len(list(open_source(str(folder)).frames())) == len(SAMPLES)


def test_damaged_first_bytes_of_an_unfinished_bag(tmp_path: Path) -> None:
    path = write_ros1(tmp_path / 'a.bag', SAMPLES).rename(tmp_path / 'a.bag.active')
    path.write_bytes(b'\xff' * 9 + path.read_bytes()[9:])
    assert len(list(BagImages(path).frames())) == len(SAMPLES)


def test_an_image_without_a_suffix(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / 'a.png'), np.full((20, 30), 7, np.uint8))
    shutil.copy(tmp_path / 'a.png', tmp_path / 'frame')
    (frame,) = open_source(str(tmp_path / 'frame')).frames()
    assert isinstance(frame, Frame) and frame.image.width == 30


@pytest.mark.parametrize(
    ('extension', 'kind'),
    [
        ('.jpg', ''),
        ('.jpg', 'mono8; jpeg compressed mono8'),
        ('.png', 'x'),
        ('.webp', 'webp'),
        ('.tiff', 'tiff'),
    ],
)
def test_compressed_images_whatever_their_format_says(
    tmp_path: Path, extension: str, kind: str
) -> None:
    data = cv2.imencode(extension, np.full((48, 64, 3), 90, np.uint8))[1].tobytes()
    sample = Sample(TOPIC, COMPRESSED_IMAGE, START_NS, compressed_image(data, kind, START_NS))
    path = write_mcap(tmp_path / 'a.mcap', [sample])
    assert images_in(path) == 1
    (topic,) = summarise(path).topics
    assert topic.images is not None
    assert topic.images.formats == [f'64x48 {kind}'.rstrip()]


def refusal_of(path: Path, kind: str, data: bytes) -> str:
    """Why an image is none, for its reader and for `mvuav info` alike."""
    (frame,) = BagImages(write_mcap(path, [Sample(TOPIC, kind, START_NS, data)])).frames()
    (topic,) = summarise(path).topics
    assert isinstance(frame, BadFrame) and topic.images is not None
    assert topic.images.first_problem == frame.reason
    return frame.reason


@pytest.mark.parametrize('extension', ['.jpg', '.png', '.webp', '.tiff'])
def test_a_header_that_claims_gigapixels(tmp_path: Path, extension: str) -> None:
    data = bytearray(cv2.imencode(extension, np.full((48, 64, 3), 90, np.uint8))[1].tobytes())
    for old, new in (
        (b'\0\x30\0\x40', b'\xff\xff\xff\xff'),
        (b'\0\0\0\x40\0\0\0\x30', b'\0\0\xff\xff\0\0\xff\xff'),
        (b'\x40\0\x30\0', b'\xff\x3f\xff\x3f'),
        (b'\0\1\3\0\1\0\0\0\x40\0', b'\0\1\3\0\1\0\0\0\xff\xff'),
        (b'\1\1\3\0\1\0\0\0\x30\0', b'\1\1\3\0\1\0\0\0\xff\xff'),
    ):
        data = data.replace(old, new, 1)
    if (lossless := data.find(b'VP8L')) > 0:
        data[lossless + 9 : lossless + 13] = b'\xff' * 4
    message = compressed_image(bytes(data), '', START_NS)
    assert 'megapixels' in refusal_of(tmp_path / 'a.mcap', COMPRESSED_IMAGE, message)


@pytest.mark.parametrize(
    ('encoding', 'reason'), [('32FC1', 'without a full scale'), ('jpeg2000', 'unknown encoding')]
)
def test_images_that_are_refused_for_the_right_reason(
    tmp_path: Path, encoding: str, reason: str
) -> None:
    message = image(1)
    message.encoding, message.step = encoding, 256
    message.data = np.zeros(256 * 48, np.uint8)
    assert reason in refusal_of(tmp_path / 'a.mcap', IMAGE, cdr(message))


def test_depth_is_refused(tmp_path: Path) -> None:
    message = compressed_image(b'0' * 40, '16UC1; compressedDepth png', START_NS)
    assert 'distances' in refusal_of(tmp_path / 'a.mcap', COMPRESSED_IMAGE, message)

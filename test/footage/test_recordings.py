"""The shared recordings do what their README says; skipped where they are absent."""

from __future__ import annotations

from pathlib import Path

import pytest

from mvuav_ros.messages.definitions import decode_message
from mvuav_ros.messages.images import IMAGE, decode_image
from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.summary import summarise
from mvuav_ros.sources.bag import choose_image_topic


@pytest.fixture(scope='module')
def bags(footage: Path) -> Path:
    return footage / 'bags'


def test_amber(bags: Path) -> None:
    folder = bags / 'amber_zstd_message_compressed'
    with open_recording(folder) as recording:
        assert choose_image_topic(recording).type == IMAGE
        images = [decode_message(m.type, m.data) for m in recording.messages()]
        assert len(images) == 2
        assert {(i.width, i.height, i.encoding) for i in map(decode_image, images)} == {
            (640, 480, 'rgb8')
        }
        # metadata.yaml is that of thirteen files, of which one is there.
        missing, unlisted = recording.account.errors
        assert missing.startswith('12 of the 13 files that metadata.yaml lists are missing')
        assert 'not listed in metadata.yaml, not read' in unlisted
    for path in folder.glob('*.mcap'):
        (topic,) = summarise(path).topics
        assert topic.images is not None and topic.images.malformed == 0


def test_rerun(bags: Path) -> None:
    summary = summarise(bags / 'rerun_humble_all_sensor_msgs_noise_images.mcap')
    formats = {t.type.split('/')[-1]: t.images.formats for t in summary.topics if t.images}
    assert formats == {'Image': ['640x480 rgb8'], 'CompressedImage': ['640x480 jpeg']}
    assert len(summary.topics) == 32
    assert summary.errors == []


def test_ros1(bags: Path) -> None:
    summary = summarise(bags / 'ros1_ros_numpy_image_and_compressed.bag')
    formats = {t.name: t.images.formats for t in summary.topics if t.images}
    assert formats['/image'] == ['360x240 rgb8']
    assert formats['/compressedimage'][0].endswith('png')
    assert summary.errors == []


def test_bare_db3(bags: Path) -> None:
    (topic,) = summarise(bags / 'ros2bag_tools_images_2x2_mono8.db3').topics
    assert topic.count == 3
    assert topic.images is not None and topic.images.formats == ['2x2 mono8']


@pytest.mark.parametrize('name', ['test_bag_mcap', 'test_bag_sqlite3'])
def test_malformed_images(bags: Path, name: str) -> None:
    summary = summarise(bags / 'malformed_images' / name)
    problems = {
        t.type.split('/')[-1]: (t.images.malformed, t.images.first_problem)
        for t in summary.topics
        if t.images
    }
    assert problems == {
        'Image': (2, '640 x 480 rgb8 with step 1920 needs 921600 bytes, the message has 30'),
        'CompressedImage': (
            2,
            "10 bytes of compressed data do not decode: no JPEG, PNG, WebP or TIFF (format 'jpeg')",
        ),
    }
    assert summary.messages == 188
    assert summary.errors == []


def test_a_folder_of_many_is_no_recording(bags: Path) -> None:
    with pytest.raises(RecordingError, match='several recordings'):
        open_recording(bags)

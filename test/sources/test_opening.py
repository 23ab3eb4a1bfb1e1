"""What a user may name as a source, and what comes out."""

import math
import os
import shutil
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.recording_samples import (
    image_samples,
    storage_file,
    write_mcap,
    write_ros1,
    write_rosbag2,
)

from mvuav_ros.messages.images import BadFrame, Frame
from mvuav_ros.recordings.layout import fingerprint
from mvuav_ros.sources.files import ImageFolder, VideoFile
from mvuav_ros.sources.opening import looks_like_bag, open_source, planned_flight
from mvuav_ros.sources.source import BEGINNING_NS, Selection, SourceError
from mvuav_ros.sources.v4l2_camera import Camera


def write_images(folder, count=12):
    folder.mkdir(exist_ok=True)
    for index in range(count):
        cv2.imwrite(str(folder / f'image_{index}.png'), np.full((20, 30), index, np.uint8))
    return folder


def write_video(path, count=10, fps=20.0):
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*'MJPG'), fps, (64, 48))
    for index in range(count):
        writer.write(np.full((48, 64, 3), 5 * index, np.uint8))
    writer.release()
    return path


def test_images_come_in_the_order_of_their_numbers(tmp_path):
    source = open_source(str(write_images(tmp_path / 'images')))
    frames = list(source.frames())
    assert [int(f.image.pixels[0, 0]) for f in frames] == list(range(12))
    assert [f.stamp_ns for f in frames] == [round(i * 1e9 / 30) or BEGINNING_NS for i in range(12)]
    assert source.count == 12
    assert source.rate == 30.0


def test_hidden_files_are_no_images(tmp_path):
    folder = write_images(tmp_path / 'images', 3)
    for index in range(3):
        (folder / f'._image_{index}.png').write_bytes(b'\0\5\x16\7' * 30)
    (folder / '._flight.mcap').touch()
    frames = list(open_source(str(folder)).frames())
    assert [int(f.image.pixels[0, 0]) for f in frames] == [0, 1, 2]


def test_a_rate_for_images(tmp_path):
    source = open_source(str(write_images(tmp_path / 'images')), rate=10.0)
    for _ in range(2):
        assert [f.stamp_ns for f in source.frames()][:3] == [1, 100_000_000, 200_000_000]
        assert source.account.kept == 12
    assert [f.stamp_ns for f in Selection(start_s=1.1).stretch(source)] == [1_100_000_000]


def test_a_glob_and_a_single_image(tmp_path):
    write_images(tmp_path)
    assert open_source(str(tmp_path / 'image_1*.png')).count == 3
    assert open_source(str(tmp_path / 'image_3.png')).count == 1


def test_a_glob_of_several_folders_takes_one_after_the_other(tmp_path):
    for number, count in ((9, 2), (10, 3)):
        write_images(tmp_path / f'part_{number}', count)
    frames = open_source(str(tmp_path / 'part_*' / '*.png')).frames()
    assert [int(frame.image.pixels[0, 0]) for frame in frames] == [0, 1, 0, 1, 2]


def test_a_glob_below_a_folder_whose_name_has_brackets(tmp_path, monkeypatch):
    folder = write_images(tmp_path / 'flight[1] (2)', 2)
    monkeypatch.chdir(tmp_path)
    for pattern in (folder, f'{folder}/*.png', f'{folder.name}/image*', 'flight*/image_?.png'):
        assert open_source(pattern).count == 2
    assert fingerprint(f'{folder}/*.png')['input_bytes'] != '0'


def test_an_image_that_does_not_decode_is_a_bad_frame(tmp_path):
    write_images(tmp_path, 3)
    (tmp_path / 'image_1.png').write_bytes(b'garbage')
    frames = list(open_source(str(tmp_path)).frames())
    assert isinstance(frames[1], BadFrame)
    assert 'image_1.png' in frames[1].reason
    assert frames[2].stamp_ns == round(2e9 / 30)


@pytest.mark.parametrize('rate', [0, -1.0, math.nan, math.inf])
def test_a_rate_that_is_none_is_refused(tmp_path, rate):
    """At -1 Hz each image came before the one before it."""
    with pytest.raises(SourceError, match='rate must be above 0 Hz'):
        open_source(str(write_images(tmp_path / 'images')), rate=rate)


def test_a_video_and_its_own_rate(tmp_path):
    source = open_source(str(write_video(tmp_path / 'flight.avi')))
    assert isinstance(source, VideoFile)
    for _ in range(2):
        frames = list(source.frames())
        assert [f.stamp_ns for f in frames] == [i * 50_000_000 or BEGINNING_NS for i in range(10)]
        assert frames[0].image.encoding == 'bgr8'
    assert source.account.errors == []
    assert source.count == 10


@pytest.mark.parametrize(
    ('name', 'words'),
    [
        ('missing.mcap', 'no such file'),
        ('empty', 'no images and no bag'),
        ('text.mp4', 'not a video'),
        ('nothing.mp4', 'nothing.mp4 is empty'),
        ('*.png', 'no images and no bag'),
        ('sim:zeppelin', 'sim:tanker and sim:runway'),
        ('sim:tanker?motion=looping', 'must be one of'),
        ('sim:tanker?colour=red', 'no such parameter'),
    ],
)
def test_what_cannot_be_opened_is_said(tmp_path, name, words):
    (tmp_path / 'empty').mkdir()
    (tmp_path / 'text.mp4').write_text('no video')
    (tmp_path / 'nothing.mp4').touch()
    text = name if name.startswith('sim:') else str(tmp_path / name)
    with pytest.raises(SourceError, match=words):
        open_source(text)


def test_cameras_are_not_opened_before_they_are_read():
    assert isinstance(open_source('3'), Camera)
    assert isinstance(open_source('/dev/video7'), Camera)
    with pytest.raises(SourceError, match='no such file'):
        open_source('3', cameras=False)


def test_what_looks_like_a_bag(tmp_path):
    write_images(tmp_path / 'images', 1)
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag' / 'metadata.yaml').touch()
    assert looks_like_bag(tmp_path / 'bag')
    assert not looks_like_bag(tmp_path / 'images')
    for name, expected in {
        'a.mcap': True,
        'a.db3.zstd': True,
        'a.bag': True,
        'a.avi': False,
    }.items():
        assert looks_like_bag(tmp_path / name) is expected


@pytest.mark.parametrize(('kind', 'encoding'), [('tanker', 'mono8'), ('runway', 'bgr8')])
def test_a_synthetic_flight_with_its_calibration(kind, encoding):
    source = open_source(f'sim:{kind}?frames=4&width=320&height=240&seed=5', rate=10.0)
    frames = list(source.frames())
    assert len(frames) == 4
    assert set(np.diff([f.stamp_ns for f in frames])) == {100_000_000}
    assert frames[0].image.encoding == encoding
    assert frames[0].image.width == 320
    frames[0].camera.check(320, 240)


def test_folders_ignore_other_files(tmp_path):
    write_images(tmp_path, 2)
    (tmp_path / 'corners.csv').write_text('frame,x,y\n')
    assert ImageFolder('here', list(tmp_path.iterdir())).count == 2


@pytest.mark.parametrize('suffix', [b'', b'.png', b'.mcap', b'.db3', b'.bag'])
def test_names_that_are_not_utf8(tmp_path: Path, suffix: bytes) -> None:
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b'/na\xefve' + suffix))
    if suffix == b'.mcap':
        write_mcap(tmp_path / 'a', image_samples(2)).rename(path)
    elif suffix == b'.db3':
        storage_file(write_rosbag2(tmp_path / 'bag', image_samples(2), 'sqlite3')).rename(path)
        shutil.rmtree(tmp_path / 'bag')
    elif suffix == b'.bag':
        write_ros1(tmp_path / 'a', image_samples(2)).rename(path)
    else:
        path.write_bytes(cv2.imencode('.png', np.zeros((8, 16), np.uint8))[1].tobytes())
    for source in (path, tmp_path):
        frames = list(open_source(str(source)).frames())
        assert frames and all(isinstance(frame, Frame) for frame in frames)


def test_a_photograph_stands_as_its_tag_says(tmp_path: Path) -> None:
    pixels = np.zeros((16, 32), np.uint8)
    pixels[:, 16:] = 200
    data = cv2.imencode('.jpg', pixels)[1].tobytes()
    for tag, shown in ((1, pixels), (3, pixels[::-1, ::-1]), (6, np.rot90(pixels, -1))):
        entry = struct.pack('<HHIHH', 0x0112, 3, 1, tag, 0)
        exif = b'Exif\0\0II*\0' + struct.pack('<IH', 8, 1) + entry + bytes(4)
        segment = b'\xff\xe1' + struct.pack('>H', len(exif) + 2) + exif
        (tmp_path / 'a.jpg').write_bytes(data[:2] + segment + data[2:])
        (frame,) = open_source(str(tmp_path / 'a.jpg')).frames()
        assert isinstance(frame, Frame) and frame.image.pixels.shape == shown.shape
        assert np.abs(frame.image.pixels.astype(int) - shown).max() < 12


def test_an_image_file_of_gigabytes_is_one_bad_frame(tmp_path: Path) -> None:
    good = cv2.imencode('.png', np.zeros((8, 16), np.uint8))[1].tobytes()
    for name in ('1.png', '2.png', '3.png'):
        (tmp_path / name).write_bytes(good)
    os.truncate(tmp_path / '2.png', 60 << 30)  # on the disk there is nothing of it
    first, bad, last = open_source(str(tmp_path)).frames()
    assert isinstance(bad, BadFrame) and 'larger than 513 MB' in bad.reason
    assert isinstance(first, Frame) and isinstance(last, Frame)


def test_a_folder_that_cannot_be_read_is_a_users_mistake(tmp_path, monkeypatch):
    def denied(_):
        raise PermissionError(13, 'Permission denied')

    monkeypatch.setattr(Path, 'iterdir', denied)
    with pytest.raises(SourceError, match=r'cannot be read: Permission denied'):
        open_source(str(tmp_path))


@pytest.mark.parametrize(
    ('settings', 'words'),
    [
        ('motion=&frames=2', 'motion has no value'),
        ('noise&frames=2', 'write settings as in'),
        ('frames=2&', 'write settings as in'),
    ],
)
def test_a_setting_without_a_value_is_no_default(settings, words):
    with pytest.raises(SourceError, match=words):
        open_source(f'sim:tanker?{settings}')


def test_numbers_of_settings_are_those_of_ros():
    assert planned_flight('sim:tanker?frames=2&noise=1e-3').settings.noise == 1e-3

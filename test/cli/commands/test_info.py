"""`mvuav info` says what is inside, and what is wrong with it."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.coded_videos import write_video
from support.commands import mvuav, stamp
from support.recording_samples import (
    TOPIC,
    cdr,
    image,
    image_samples,
    string_sample,
    write_mcap,
    write_ros1,
    write_rosbag2,
)


def row(out: str, topic: str) -> str:
    (line,) = [line for line in out.splitlines() if line.startswith(f'{topic} ')]
    return ' '.join(line.split())


@pytest.mark.parametrize('kind', ['mcap', 'sqlite3', 'ros1', 'bare'])
def test_a_whole_recording(tmp_path: Path, kind: str) -> None:
    samples = [*image_samples(31), string_sample(31)]
    if kind == 'ros1':
        bag = write_ros1(tmp_path / 'in.bag', samples)
    elif kind == 'bare':
        bag = write_mcap(tmp_path / 'in.mcap', samples)
    else:
        bag = write_rosbag2(tmp_path / 'in', samples, kind)
    run = mvuav('info', bag)
    assert (run.status, run.err) == (0, '')
    assert run.out.splitlines()[0] == f'{bag}: 32 messages in 1.03 s'
    assert row(run.out, TOPIC) == f'{TOPIC} sensor_msgs/msg/Image 31 30.00 64x48 mono8'
    assert row(run.out, '/note') == '/note std_msgs/msg/String 1 -'


def test_gaps_jumps_and_damage(tmp_path: Path) -> None:
    samples = image_samples(40)
    early = samples[0]
    del samples[10:13]
    short = image(23)
    short.data = short.data[:30]
    samples[20] = samples[20]._replace(data=cdr(short))
    samples = [*samples, early, string_sample(1, '/web')]
    bag = write_mcap(tmp_path / 'in.mcap', samples, encodings={'/web': 'json'})
    run = mvuav('info', bag)
    assert run.status == 0
    warnings = row(run.out, TOPIC)
    for words in (
        '1 gap, longest 0.13 s',
        'time jumps back 1 time',
        'stamps jump back 1 time',
        '1 malformed: 64 x 48 mono8 with step 64 needs 3072 bytes, the message has 30',
    ):
        assert words in warnings
    assert 'skipped: /web is json, not CDR' in run.out
    bag.write_bytes(bag.read_bytes()[:-30_000])
    cut = mvuav('info', bag)
    assert cut.status == 0
    assert 'damage: in.mcap: cut off' in cut.err
    assert 'kept, an unknown number lost' in cut.err


def test_json_holds_the_same(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / 'bag', image_samples(31))
    (folder / 'metadata.yaml').unlink()
    run = mvuav('info', folder, '--json')
    assert run.status == 0
    content = json.loads(run.out)
    (topic,) = content['topics']
    assert topic['name'] == TOPIC
    assert topic['rate_hz'] == pytest.approx(30)
    assert topic['first_stamp_ns'] == stamp(0)
    assert topic['images']['formats'] == ['64x48 mono8']
    assert content['messages'] == topic['count'] == 31
    assert content['errors'] == []
    assert content['warnings'] == ['bag: metadata.yaml is missing']
    assert 'note: bag: metadata.yaml is missing' in mvuav('info', folder).err
    (account,) = content['accounts']
    assert (account['kept'], account['lost'], account['is_exact']) == (31, 0, True)


def test_missing_parts_of_a_recording_are_one_line(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / 'bag', image_samples(3))
    metadata = folder / 'metadata.yaml'
    present = 'relative_file_paths:\n  - bag.mcap\n'
    missing = ''.join(f'  - bag_{n}.mcap\n' for n in range(1, 6))
    assert present in metadata.read_text()
    metadata.write_text(metadata.read_text().replace(present, present + missing))
    damage, _balance = mvuav('info', folder).err.splitlines()
    assert damage == (
        'damage: 5 of the 6 files that metadata.yaml lists are missing: '
        'bag_1.mcap, bag_2.mcap, bag_3.mcap, …'
    )


def test_images(tmp_path: Path) -> None:
    for number in range(3):
        cv2.imwrite(str(tmp_path / f'{number}.png'), np.zeros((8, 16), np.uint8))
    (tmp_path / '3.png').write_bytes(b'no image')
    run = mvuav('info', tmp_path)
    assert run.status == 0
    rate = '30.00 Hz (assumed, as there are no stamps)'
    assert f'{tmp_path}: 4 frames, {rate}, 0.10 s, 16x8 mono8' in run.out
    assert 'damage: 1 frame not decoded' in run.err
    assert json.loads(mvuav('info', tmp_path, '--json').out)['unusable'] == 1


@pytest.mark.parametrize('suffix', ['.mp4', '.mkv', '.avi'])
def test_a_video_of_variable_rate(tmp_path: Path, suffix: str) -> None:
    path = write_video(tmp_path / f'a{suffix}', [0, 33, 100, 101, 500, 12_947])
    run = mvuav('info', path)
    assert run.out == f'{path}: 6 frames, 14.93 Hz, 12.95 s, 64x48 bgr8\n'


@pytest.mark.parametrize('name', ['missing.mcap', 'empty.mcap', 'empty', 'text.txt', 'folder'])
def test_what_cannot_be_read_costs_one_line(tmp_path: Path, name: str) -> None:
    (tmp_path / 'empty.mcap').touch()
    (tmp_path / 'empty').touch()
    (tmp_path / 'text.txt').write_text('no bag')
    (tmp_path / 'folder').mkdir()
    run = mvuav('info', tmp_path / name)
    assert run.status == 1
    assert name in run.error
    assert len(run.err.splitlines()) == 1

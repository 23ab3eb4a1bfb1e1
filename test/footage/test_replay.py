"""The shared footage through `mvuav info` and `mvuav replay`; skipped where it is absent."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.commands import MARKERS, counts, mvuav, mvuav_process, read

from mvuav_ros.messages.definitions import decode_message

MALFORMED = ['malformed_images/test_bag_mcap', 'malformed_images/test_bag_sqlite3']


@pytest.fixture
def bags(footage: Path) -> Path:
    return footage / 'bags'


@pytest.mark.parametrize(
    ('name', 'topic', 'usable', 'frames', 'told'),
    [
        ('amber_zstd_message_compressed', None, 2, 2, '640x480 rgb8'),
        ('amber_zstd_message_compressed/soccer_goal_12.mcap', None, 2, 2, '640x480 rgb8'),
        ('rerun_humble_all_sensor_msgs_noise_images.mcap', '/image', 1, 1, '640x480 rgb8'),
        (
            'rerun_humble_all_sensor_msgs_noise_images.mcap',
            '/compressed_image',
            1,
            1,
            '640x480 jpeg',
        ),
        ('ros1_ros_numpy_image_and_compressed.bag', '/image', 1, 1, '360x240 rgb8'),
        ('ros1_ros_numpy_image_and_compressed.bag', '/compressedimage', 1, 1, 'png'),
        # Two of its stamps have a second or more of nanoseconds.
        ('ros2bag_tools_images_2x2_mono8.db3', None, 1, 3, '2x2 mono8'),
    ],
)
def test_bags(
    bags: Path, tmp_path: Path, name: str, topic: str | None, usable: int, frames: int, told: str
) -> None:
    info = mvuav('info', bags / name)
    assert info.status == 0
    assert told in info.out
    out = tmp_path / 'out.mcap'
    options = ['--image-topic', topic] if topic else []
    run = mvuav('replay', bags / name, '-o', out, '--keep-inputs', *options)
    assert run.status == 0
    assert f'results for {usable} of {frames} frames' in run.out
    assert counts(out)[MARKERS] == counts(out)['/runway_detector/lines'] == usable
    if topic is not None:
        assert 'choose one of them' in mvuav('replay', bags / name, '-o', out, '--force').error


def test_an_incomplete_folder_is_told_and_not_strict(bags: Path, tmp_path: Path) -> None:
    folder = bags / 'amber_zstd_message_compressed'
    run = mvuav('replay', folder, '-o', tmp_path / 'out.mcap', '--strict')
    assert run.status == 1
    missing, unlisted, kept, throughout, why = run.err.splitlines()
    assert '12 of the 13 files that metadata.yaml lists are missing' in missing
    assert 'not listed in metadata.yaml, not read' in unlisted
    assert '2 kept' in kept and '--strict' in why
    assert throughout.startswith('note: marker_tracker, every frame: ')


@pytest.mark.parametrize('name', MALFORMED)
@pytest.mark.parametrize(
    ('topic', 'problem'),
    [
        ('/test/sensor_msgs/image', 'needs 921600 bytes, the message has 30'),
        ('/test/sensor_msgs/compressed_image', '10 bytes of compressed data do not decode'),
    ],
)
def test_malformed_images_are_counted_and_survived(
    bags: Path, tmp_path: Path, name: str, topic: str, problem: str
) -> None:
    assert '2 malformed' in mvuav('info', bags / name).out
    run = mvuav('replay', bags / name, '-o', tmp_path / 'out.mcap', '--image-topic', topic)
    assert (run.status, run.out) == (1, '')
    assert 'warning: 2 without a result: ' in run.err and problem in run.err
    assert 'not a single frame could be used' in run.error


def test_all_bags_in_one_command(bags: Path, tmp_path: Path) -> None:
    sources = [bags / 'amber_zstd_message_compressed', *(bags / name for name in MALFORMED)]
    sources += [bags / 'ros2bag_tools_images_2x2_mono8.db3']
    run = mvuav_process('replay', *sources, '-o', tmp_path / 'out', '--jobs', 2)
    assert run.status == 1
    assert run.err.splitlines()[-1] == 'mvuav: 2 of 4 recordings failed'
    assert counts(tmp_path / 'out' / 'ros2bag_tools_images_2x2_mono8.mcap')[MARKERS] == 1


@pytest.mark.parametrize(
    ('name', 'parameters', 'clusters', 'enough', 'frames'),
    [
        (
            'ir5_fisheye_752x480.avi',
            {'threshold': 0.5, 'grouping_distance': 13},
            5,
            399,
            402,
        ),
        ('ir3_stereo_left_640x480_50fps.avi', {'threshold': 0.5}, 3, 2490, 2509),
        ('uv_grid_960x600', {'threshold': 0.353, 'grouping_distance': 8}, 35, 4, 4),
    ],
)
def test_leds(
    footage: Path,
    tmp_path: Path,
    name: str,
    parameters: dict[str, float],
    clusters: int,
    enough: int,
    frames: int,
) -> None:
    out = tmp_path / 'out.mcap'
    options = ['--nodes', 'marker_tracker']
    for key, value in {'mode': 'detect_any', **parameters}.items():
        options += ['--param', f'marker_tracker:{key}:={value}']
    assert mvuav('replay', footage / 'led' / name, '-o', out, *options).status == 0
    widths = [
        decode_message(message.type, message.data).width
        for message in read(out)
        if message.topic == MARKERS
    ]
    assert len(widths) == frames
    assert widths.count(clusters) >= enough

"""Folders of recordings, and what is one recording."""

from pathlib import Path

import pytest
from support.commands import mvuav, stamps
from support.recording_samples import image_samples, write_mcap, write_ros1, write_rosbag2

from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.layout import by_flight, recordings_in
from mvuav_ros.recordings.reading import open_recording

NODE = ('--nodes', 'marker_tracker', '--param', 'marker_tracker:mode:=detect_any')


def touch(folder: Path, *names: str) -> Path:
    folder.mkdir(parents=True)
    for name in names:
        (folder / name).write_bytes(b'\x89PNG' if name.endswith('png') else b'')
    return folder


@pytest.mark.parametrize(
    ('names', 'expected'),
    [
        # Flights, whatever lies beside them.
        (['flight_2.mcap', 'flight_10.mcap', 'notes.txt', 'map.png'], 2),
        (['a.mcap', 'b.bag', 'c.db3', 'd.mp4', '.hidden.mcap'], 4),
        (['a.mcap', 'a.mcap.zstd', 'b.mcap.zstd'], 2),
        (['a.mcap', 'b.mp4'], 2),
        (['a.mp4', 'b.mp4'], 2),
        (['rosbag2_2026_01_02-03_04_05_0.db3', 'rosbag2_2026_01_03-03_04_05_0.db3'], 2),
        (['2026-01-02-03-04-05_0.bag', '2026-01-03-03-04-05_0.bag'], 2),
        # One recording.
        (['season_0.mcap', 'season_1.mcap'], 0),
        (['rosbag2_2026_01_02-03_04_05_0.db3', 'rosbag2_2026_01_02-03_04_05_1.db3'], 0),
        (['2026-01-02-03-04-05_0.bag', '2026-01-02-03-14-05_1.bag'], 0),
        (['a.mcap', 'b.mcap', 'metadata.yaml'], 0),
        (['1.png', '2.png'], 0),
        (['a.mcap'], 0),
        ([], 0),
    ],
)
def test_a_folder_is_one_recording_or_several(
    tmp_path: Path, names: list[str], expected: int
) -> None:
    folder = touch(tmp_path / 'season', *names)
    found = recordings_in(str(folder))
    assert found == [str(folder)] if expected == 0 else len(found) == expected
    assert [Path(f).name for f in found] == sorted(
        (Path(f).name for f in found), key=lambda name: (name[0], len(name))
    )


def test_parts_that_ros1_names_by_the_time_alone_are_one_recording(tmp_path: Path) -> None:
    samples = image_samples(6)
    for number, name in enumerate(('2026-01-02-03-04-05_0.bag', '2026-01-02-03-14-05_1.bag')):
        write_ros1(tmp_path / name, samples[3 * number : 3 * number + 3])
    assert recordings_in(str(tmp_path)) == [str(tmp_path)]
    with open_recording(tmp_path) as recording:
        assert len(list(recording.messages())) == 6
    (tmp_path / '2026-01-02-03-14-05_1.bag').rename(tmp_path / '2026-01-03-03-14-05_0.bag')
    with pytest.raises(RecordingError, match='several recordings'):
        open_recording(tmp_path)


def test_folders_of_images_and_rosbag2_folders_are_recordings_of_a_folder(tmp_path: Path) -> None:
    touch(tmp_path / 'season' / 'images', '1.png', '2.png')
    touch(tmp_path / 'season' / 'bag', 'bag_0.mcap', 'metadata.yaml')
    touch(tmp_path / 'season' / 'notes', 'a.txt')
    names = [Path(found).name for found in recordings_in(str(tmp_path / 'season'))]
    assert names == ['bag', 'images']
    (tmp_path / 'season' / 'last.mcap').touch()
    assert len(recordings_in(str(tmp_path / 'season'))) == 3


def test_two_flights_of_one_name_are_refused() -> None:
    assert by_flight(['a/x.mcap', 'a/y.bag']) == {'x': 'a/x.mcap', 'y': 'a/y.bag'}
    with pytest.raises(RecordingError, match=r'a/x.mcap and b/x.db3 would both become x'):
        by_flight(['a/x.mcap', 'b/x.db3'])


def test_a_folder_of_bags_is_replayed_flight_by_flight(tmp_path: Path) -> None:
    season = tmp_path / 'season'
    season.mkdir()
    for number, length in enumerate((3, 5)):
        # All begin at the same time: glued together they would jump back.
        write_mcap(season / f'flight_{number}.mcap', image_samples(length))
    write_rosbag2(season / 'last', image_samples(4))
    assert 'need a folder' in mvuav('replay', season, '-o', tmp_path / 'out.mcap', *NODE).error
    out = tmp_path / 'results'
    assert mvuav('replay', season, '-o', out, *NODE).status == 0
    counts = {path.stem: len(stamps(path)) for path in out.glob('*.mcap')}
    assert counts == {'flight_0': 3, 'flight_1': 5, 'last': 4}


def test_brackets_in_a_name_are_no_pattern(tmp_path: Path) -> None:
    season = touch(tmp_path / 'season', 'flight [1].mcap', 'flight [2].mcap', '1.png')
    flights = by_flight([str(season / 'flight [1].mcap'), str(season / 'flight [2].mcap')])
    assert list(flights) == ['flight [1]', 'flight [2]']
    assert list(by_flight([str(season / '*.png')])) == ['season']

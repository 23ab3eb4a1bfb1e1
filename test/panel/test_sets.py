"""Named sets of the panel: ordinary parameter files that cannot leave their folder."""

import os
import threading
from itertools import pairwise
from pathlib import Path

import pytest

from mvuav_ros.panel.sanitized import NameRefusedError, checked_name
from mvuav_ros.panel.sets import SetStore, differences
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.parameters.parameter_file import load_parameters
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.recordings.layout import shipped_folder

KIND = 'marker_tracker'
OUTSIDE = [
    '',
    ' ',
    '.',
    '..',
    '../other',
    'a/b',
    'a\\b',
    '/etc/passwd',
    '.hidden',
    'ends.',
    'a..b',
    'nul\0',
    'line\nbreak',
    'x' * 65,
    '<b>bold</b>',
    'ünï',
    '~root',
    '$HOME',
]


@pytest.mark.parametrize('name', OUTSIDE)
def test_a_name_cannot_leave_its_folder(name, tmp_path):
    with pytest.raises(NameRefusedError):
        checked_name(name)
    store = SetStore(tmp_path / 'sets')
    for act in (lambda: store.save(name, KIND, {'threshold': 0.5}), lambda: store.delete(name)):
        with pytest.raises(NameRefusedError):
            act()
    with pytest.raises(NameRefusedError):
        store.load(name, KIND)
    assert list(tmp_path.rglob('*')) == []


@pytest.mark.parametrize('name', ['night', 'Night 2', 'rain_7', 'v1.2-final', '7'])
def test_ordinary_names_are_taken(name):
    assert checked_name(f' {name} ') == name


def test_a_saved_set_is_a_parameter_file_that_every_node_of_the_kind_can_load(tmp_path):
    store = SetStore(tmp_path / 'sets')
    values = {**MarkerTrackerParameters().as_dict(), 'threshold': 0.55, 'mode': 'detect'}
    path = store.save('night', KIND, values)
    assert path.parent == tmp_path / 'sets'
    read = load_parameters(path, KIND)
    assert read.as_dict() == values
    assert store.load('night', KIND) == values
    assert read.threshold == 0.55
    assert store.names(KIND) == ['night']
    assert store.names('runway_detector') == []
    store.delete('night')
    assert store.names(KIND) == []


def test_a_set_that_is_saved_for_one_node_keeps_what_it_says_of_another(tmp_path):
    store = SetStore(tmp_path)
    store.save('night', KIND, {'threshold': 0.55})
    store.save('night', 'runway_detector', {'num_peaks': 4})
    store.save('night', KIND, {'threshold': 0.5})
    said = {kind: store.load('night', kind) for kind in (KIND, 'runway_detector')}
    assert said == {KIND: {'threshold': 0.5}, 'runway_detector': {'num_peaks': 4}}
    store.save('night', 'runway_detector', {'num_peaks': 2})
    assert store.load('night', KIND) == {'threshold': 0.5}


def test_several_numbers_survive_a_set(tmp_path):
    store, kind = SetStore(tmp_path), 'runway_detector'
    values = {**RunwayDetectorParameters().as_dict(), 'camera_mount_rpy_deg': (0.0, -10.5, 3.0)}
    path = store.save('tilted', kind, values)
    assert store.load('tilted', kind) == values
    read = load_parameters(path, kind)
    assert read.camera_mount_rpy_deg == (0.0, -10.5, 3.0)


def test_shipped_sets_come_first_and_cannot_be_overwritten_or_deleted(tmp_path):
    store = SetStore(tmp_path / 'sets', shipped_folder('config'))
    store.save('a first one', KIND, {'threshold': 0.5})
    assert store.names(KIND) == ['default', 'thesis', 'a first one']
    assert store.load('default', KIND) == MarkerTrackerParameters().as_dict()
    for name in ('default', ' thesis '):
        with pytest.raises(NameRefusedError, match='part of the package'):
            store.save(name, KIND, {'threshold': 0.5})
    with pytest.raises(NameRefusedError, match='part of the package'):
        store.delete('default')


def test_foreign_files_in_the_folder_are_left_out(tmp_path):
    (tmp_path / 'broken.yaml').write_text('{')
    (tmp_path / 'list.yaml').write_text('[1, 2]')
    (tmp_path / '.hidden.yaml').write_text('marker_tracker: {ros__parameters: {threshold: 0.5}}')
    (tmp_path / 'good.yaml').write_text('marker_tracker: {ros__parameters: {threshold: 0.5}}')
    assert SetStore(tmp_path).names(KIND) == ['good']


STRANGE = {
    'fifo': os.mkfifo,
    'folder': Path.mkdir,
    'device': lambda path: path.symlink_to('/dev/zero'),
    'nowhere': lambda path: path.symlink_to('nowhere'),
    'long': lambda path: path.write_bytes(b' ' * 200_000),
    **{
        name: lambda path, words=words: path.write_text(
            f'marker_tracker: {{ros__parameters: {{threshold: {words}}}}}'
        )
        for name, words in (('int', '!!int ""'), ('bool', '!!bool x'), ('digits', '1' * 5000))
    },
}


def test_whatever_lies_in_the_folder_is_named_with_a_reason_and_waited_for_never(tmp_path):
    store, found = SetStore(tmp_path), []
    store.save('good', KIND, {'threshold': 0.5})
    for name, make in STRANGE.items():
        make(tmp_path / f'{name}.yaml')
    os.mkfifo(tmp_path / 'good.new')

    def use():
        found.extend(store.names(KIND))
        store.save('good', KIND, {'threshold': 0.6})
        for name in STRANGE:
            with pytest.raises(ParameterError):
                store.load(name, KIND)

    thread = threading.Thread(target=use, daemon=True)
    thread.start()
    thread.join(60.0)
    assert not thread.is_alive(), 'it waits for somebody to write into a FIFO'
    assert found == ['good'] and store.load('good', KIND) == {'threshold': 0.6}
    assert store.rejected.keys() == STRANGE.keys() and all(store.rejected.values())


def test_differences_of_two_sets():
    left = {'threshold': 0.7, 'mode': 'track', 'min_area': 1}
    right = {'threshold': 0.6, 'mode': 'track', 'max_area': 0}
    assert differences(left, right) == {'threshold': (0.7, 0.6)}


def test_a_file_from_elsewhere_is_taken_in_if_it_is_one_of_ours(tmp_path):
    store = SetStore(tmp_path / 'sets')
    good = b'marker_tracker: {ros__parameters: {threshold: 0.5}}'
    assert store.add('night', good) == [KIND]
    assert store.load('night', KIND) == {'threshold': 0.5} and store.content('night') == good
    laughs = '\n'.join(f'{b}: &{b} [*{a}, *{a}]' for a, b in pairwise('abcdefgh'))
    for content in (
        b'',
        b'{',
        b'\xff\xfe',
        b'[' * 50_000,
        b'other: {ros__parameters: {x: 1}}',
        f'a: &a [1]\n{laughs}'.encode(),
        b'marker_tracker: {ros__parameters: {threshold: &a 0.5, max_distance: *a}}',
        good + b' ' * 200_000,
    ):
        with pytest.raises(ParameterError):
            store.add('bad', content)
    for name in ('night', '../out', ''):
        with pytest.raises(NameRefusedError):
            store.add(name, good)
    assert [path.name for path in store.folder.iterdir()] == ['night.yaml']

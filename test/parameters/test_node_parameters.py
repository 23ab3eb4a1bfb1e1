"""What replay, evaluate and sweep make of parameter files and options."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.commands import mvuav
from support.places import ROOT

from mvuav_ros import load_parameters
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.parameters.parameter_file import complete, node_names, resolve_parameters

BAG = ROOT / 'bags' / 'tanker.mcap'


def file_with(folder: Path, name: str) -> Path:
    path = folder / 'parameters.yaml'
    path.write_text(f'marker_tracker:\n  ros__parameters:\n    {name}: 7\n')
    return path


def test_assignments_win_over_the_file_and_ros_own_parameters_are_left_out(tmp_path: Path) -> None:
    path = file_with(tmp_path, 'use_sim_time: true\n    search_radius')
    nodes = ['marker_tracker', 'runway_detector']
    assert resolve_parameters(nodes, [path]) == {
        'marker_tracker': {'search_radius': 7},
        'runway_detector': {},
    }
    changed = resolve_parameters(nodes, [path], ['marker_tracker:search_radius:=9'])
    assert changed['marker_tracker'] == {'search_radius': 9}
    assert complete(changed)['marker_tracker']['search_radius'] == 9
    assert len(complete(changed)['runway_detector']) > 5


@pytest.mark.parametrize(
    ('order', 'threshold'), [('ab', 0.2), ('ba', 0.2), ('ac', 0.4), ('ca', 0.1), ('cb', 0.3)]
)
def test_of_several_files_the_values_are_those_that_ros_takes(
    tmp_path: Path, order: str, threshold: float
) -> None:
    """As rclpy has them: a wildcard of a later file does not win over a node named before."""
    texts = {
        'a': '/**: {ros__parameters: {threshold: 0.1}}\n'
        'marker_tracker: {ros__parameters: {threshold: 0.2, search_radius: 7}}\n',
        'b': '/**: {ros__parameters: {threshold: 0.3}}\n',
        'c': '/marker_tracker: {ros__parameters: {threshold: 0.4}}\n',
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    given = resolve_parameters(['marker_tracker'], [tmp_path / name for name in order])
    radius = {'search_radius': 7} if 'a' in order else {}
    assert given == {'marker_tracker': {'threshold': threshold, **radius}}


def test_a_misspelt_name_is_refused_wherever_it_stands(tmp_path: Path) -> None:
    path = file_with(tmp_path, 'search_radios')
    for given in (([path], []), ((), ['marker_tracker:search_radios:=7'])):
        with pytest.raises(ParameterError, match='search_radios'):
            resolve_parameters(['marker_tracker'], *given)
    with pytest.raises(ParameterError, match='marker_trackr'):
        resolve_parameters(['marker_tracker'], (), ['marker_trackr:threshold:=0.5'])
    with pytest.raises(ParameterError, match='marker_trackr'):
        node_names('marker_trackr')


@pytest.mark.parametrize('command', ['replay', 'evaluate', 'sweep'])
def test_every_command_refuses_it(tmp_path: Path, command: str) -> None:
    files = file_with(tmp_path, 'search_radios'), ROOT / 'config' / 'default.yaml'
    given = [word for file in files for word in ('--params-file', file)]
    run = mvuav(command, BAG, '-o', tmp_path / 'out', *given)
    assert run.status == 1
    assert 'search_radios' in run.error
    assert not list(tmp_path.glob('out/*'))


@pytest.mark.parametrize(
    'key', ['marker_trackr', '/ns/marker_trackr', '/**/marker_trackr', 'markr*']
)
def test_a_misspelt_node_in_a_file_is_refused(tmp_path: Path, key: str) -> None:
    path = tmp_path / 'parameters.yaml'
    path.write_text(
        f'/**/runway_detector: {{ros__parameters: {{num_peaks: 2}}}}\n'
        f"'{key}': {{ros__parameters: {{threshold: 0.5}}}}\n"
    )
    with pytest.raises(ParameterError, match=r'no such node: .*; there are video_source'):
        resolve_parameters(['marker_tracker'], [path])
    with pytest.raises(ParameterError, match='no such node'):
        load_parameters(path, 'marker_tracker')
    run = mvuav('replay', BAG, '-o', tmp_path / 'out.mcap', '--params-file', path)
    assert 'no such node' in run.error and not (tmp_path / 'out.mcap').exists()


def test_a_file_of_a_whole_robot_is_taken(tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    other = (
        '/camera_driver: {ros__parameters: {gain: 3}}\n'
        'ekf_filter_node: {ros__parameters: {frequency: 30.0}}\n'
    )
    path.write_text(other + '/uav/marker_tracker: {ros__parameters: {threshold: 0.5}}\n')
    assert resolve_parameters(['marker_tracker'], [path]) == {'marker_tracker': {'threshold': 0.5}}
    path.write_text(other)
    with pytest.raises(
        ParameterError, match='no such node: /camera_driver; there are video_source'
    ):
        resolve_parameters(['marker_tracker'], [path])


def test_of_a_node_in_several_namespaces_the_image_topics_own_counts(tmp_path: Path) -> None:
    """As the live node of that camera has it: the mount of another camera is silently wrong."""
    path = tmp_path / 'cameras.yaml'
    path.write_text(
        '/**: {ros__parameters: {threshold: 0.3, min_area: 2}}\n'
        '/left/marker_tracker: {ros__parameters: {camera_mount_xyz: [0.0, 0.5, 0.0]}}\n'
        '/right/marker_tracker: {ros__parameters: {threshold: 0.4}}\n'
        '/right/nose/marker_tracker: {ros__parameters: {threshold: 0.5}}\n'
    )

    def of(topic: str | None) -> dict[str, object]:
        return resolve_parameters(['marker_tracker'], [path], (), topic)['marker_tracker']

    assert of('/left/image_raw') == {
        'threshold': 0.3,
        'min_area': 2,
        'camera_mount_xyz': (0.0, 0.5, 0.0),
    }
    assert of('right/image_raw') == {'threshold': 0.4, 'min_area': 2}
    assert of('/right/nose/image_raw') == {'threshold': 0.5, 'min_area': 2}
    for unclear in (None, '/image_raw', '/lefty/image_raw'):
        with pytest.raises(
            ParameterError, match='/left/marker_tracker and /right/marker_tracker and'
        ):
            of(unclear)
    with path.open('a') as file:
        file.write('/marker_tracker: {ros__parameters: {threshold: 0.6}}\n')
    assert of('/camera/image_raw')['threshold'] == 0.6
    assert of('/right/image_raw')['threshold'] == 0.4
    run = mvuav('replay', BAG, '-o', tmp_path / 'out.mcap', '--params-file', path)
    assert '--image-topic' in run.error and not (tmp_path / 'out.mcap').exists()


def test_a_camera_without_a_section_has_that_of_all_cameras(tmp_path: Path) -> None:
    """As the live node of that camera has it, not what is set for another camera alone."""
    path = tmp_path / 'cameras.yaml'
    path.write_text(
        '/**/marker_tracker: {ros__parameters: {threshold: 0.4}}\n'
        '/left/marker_tracker: {ros__parameters: {threshold: 0.6}}\n'
    )
    thresholds = {'/left/image_raw': 0.6, '/right/image_raw': 0.4, '/image_raw': 0.4}
    for topic, threshold in thresholds.items():
        given = resolve_parameters(['marker_tracker'], [path], (), topic)
        assert given == {'marker_tracker': {'threshold': threshold}}, topic
    path.write_text(path.read_text().replace('/**/marker_tracker', '/**'))
    given = resolve_parameters(['marker_tracker'], [path], (), '/camera/image_raw')
    assert given == {'marker_tracker': {'threshold': 0.6}}, 'the only node of the file'


def test_nodes_of_one_name_that_agree_are_one(tmp_path: Path) -> None:
    path = tmp_path / 'cameras.yaml'
    section = '/marker_tracker: {ros__parameters: {threshold: 0.4}}\n'
    path.write_text(f'/left{section}/right{section}{section}')
    assert load_parameters(path, 'marker_tracker') == MarkerTrackerParameters(threshold=0.4)

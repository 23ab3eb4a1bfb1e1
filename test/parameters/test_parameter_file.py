"""A node's parameters from a file."""

import pytest

from mvuav_ros import load_parameters
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.parameters.parameter_file import fits, resolve_parameters


def test_a_dump_of_a_running_node_can_be_loaded(tmp_path):
    file = tmp_path / 'dump.yaml'
    file.write_text(
        '/runway_detector:\n  ros__parameters:\n    num_peaks: 2\n    use_sim_time: false\n'
        '    qos_overrides:\n      /parameter_events:\n        publisher:\n          depth: 1000\n'
    )
    assert load_parameters(file, 'runway_detector').num_peaks == 2
    assert load_parameters(str(file), 'marker_tracker').threshold == 0.7


@pytest.mark.parametrize(
    ('node', 'line', 'words'),
    [
        ('marker_tracker', 'treshold: 0.5', 'treshold'),
        ('marker_tracker', 'threshold: 3', 'threshold: must be 0 to 1'),
        ('tracker', 'threshold: 0.5', 'no such node; there are video_source, marker_tracker'),
    ],
)
def test_what_cannot_be_is_refused_with_the_reason(tmp_path, node, line, words):
    file = tmp_path / 'wrong.yaml'
    file.write_text(f'/**:\n  ros__parameters:\n    {line}\n')
    with pytest.raises(ParameterError, match=words):
        load_parameters(file, node)


def test_a_section_for_all_nodes_may_hold_parameters_of_each(tmp_path):
    """As the nodes themselves take it."""
    file = tmp_path / 'both.yaml'
    file.write_text('/**:\n  ros__parameters:\n    threshold: 0.5\n    num_peaks: 2\n')
    assert resolve_parameters(['marker_tracker', 'runway_detector'], [file]) == {
        'marker_tracker': {'threshold': 0.5},
        'runway_detector': {'num_peaks': 2},
    }
    file.write_text('runway_detector:\n  ros__parameters:\n    threshold: 0.5\n')
    with pytest.raises(ParameterError, match='threshold: no such parameter'):
        resolve_parameters(['runway_detector'], [file])


@pytest.mark.parametrize(
    ('key', 'nodes'),
    [
        ('tracker', ['/tracker']),
        ('/a/tracker', ['/a/tracker']),
        ('/*/tracker', ['/a/tracker']),
        ('/*', ['/tracker']),
        ('/**/tracker', ['/tracker', '/a/tracker', '/a/b/tracker']),
        ('/**', ['/tracker', '/a/tracker', '/a/b/tracker']),
    ],
)
def test_a_key_fits_the_nodes_for_which_ros_takes_it(key, nodes):
    every = ('/tracker', '/a/tracker', '/a/b/tracker')
    assert [node for node in every if fits(key, node)] == nodes


@pytest.mark.parametrize(
    ('text', 'value'), [('1e-7', 1e-7), ('2E-6', 2e-6), ('1.5e-6', 1.5e-6), ('.5e-6', 5e-7)]
)
def test_numbers_are_those_of_ros(tmp_path, text, value):
    """PyYAML by itself takes the first two for texts."""
    file = tmp_path / 'mine.yaml'
    file.write_text(f'/**:\n  ros__parameters:\n    integrity_risk: {text}\n')
    assert load_parameters(file, 'marker_tracker').integrity_risk == value
    given = [f'marker_tracker:integrity_risk:={text}']
    assert resolve_parameters(['marker_tracker'], (), given) == {
        'marker_tracker': {'integrity_risk': value}
    }


def test_a_sign_before_a_point_begins_a_number(tmp_path):
    """PyYAML takes ``-.1`` for a text, and ``.1`` for a number."""
    given = ['marker_tracker:camera_mount_xyz:=[-.1, +.2, .3]', 'marker_tracker:threshold:=+.5']
    found = resolve_parameters(['marker_tracker'], (), given)['marker_tracker']
    assert found == {'camera_mount_xyz': (-0.1, 0.2, 0.3), 'threshold': 0.5}


@pytest.mark.parametrize('text', ['e7', '1e', '-.', "'-.5'", "'1e-7'", '1e-7m', 'true'])
def test_what_is_no_number_is_none(tmp_path, text):
    with pytest.raises(ParameterError, match='takes a number'):
        resolve_parameters(['marker_tracker'], (), [f'marker_tracker:integrity_risk:={text}'])


@pytest.mark.parametrize(
    ('value', 'words'),
    [
        ('1' + 400 * '0', 'too large'),
        ('1' + 40 * '0', 'not the number 1e'),
        ('&a {b: *a}', 'recursive'),
    ],
)
def test_a_number_without_end_and_an_anchor_within_itself_are_refused(tmp_path, value, words):
    file = tmp_path / 'odd.yaml'
    file.write_text(f'/**:\n  ros__parameters:\n    peak_neighborhood_rho: {value}\n')
    with pytest.raises(ParameterError, match=words):
        load_parameters(file, 'runway_detector')

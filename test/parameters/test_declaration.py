"""Declaring, validating and reading parameters."""

import dataclasses
from dataclasses import dataclass

import numpy as np
import pytest

from mvuav_ros.parameters.declaration import ParameterError, ParameterSet, parameter
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.parameters.parameter_file import (
    load_parameters,
    parameter_values,
    parse_assignment,
)
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.parameters.video_source import VideoSourceParameters


@dataclass(frozen=True)
class Sample(ParameterSet):
    """Of every kind one."""

    ratio: float = parameter(0.5, 'A ratio.', limits=(0.0, 1.0))
    count: int = parameter(3, 'A count.', limits=(1, 9), odd=True)
    mode: str = parameter('slow', 'A mode.', choices=('slow', 'fast'))
    name: str = parameter('', 'A name.')
    on: bool = parameter(False, 'A switch.')
    low: int = parameter(0, 'Less than high.')
    high: int = parameter(10, 'More than low.')

    def _check_together(self) -> None:
        if self.low >= self.high:
            raise ParameterError('low', f'must be less than high ({self.high}), not {self.low}')


@pytest.mark.parametrize(
    ('name', 'value', 'kept'),
    [
        ('ratio', 1, 1.0),
        ('ratio', 0.25, 0.25),
        ('count', 9, 9),
        ('mode', 'fast', 'fast'),
        ('name', 'nose', 'nose'),
        ('name', 0, '0'),
        ('on', True, True),
    ],
)
def test_values_are_taken_and_converted(name, value, kept):
    taken = getattr(Sample().changed({name: value}), name)
    assert taken == kept
    assert type(taken) is type(kept)


@pytest.mark.parametrize(
    ('name', 'value', 'reason'),
    [
        ('ratio', 1.5, 'must be 0 to 1, not 1.5'),
        ('ratio', float('nan'), 'must be a finite number'),
        ('ratio', float('inf'), 'must be a finite number'),
        ('ratio', '0.5', 'takes a number, not the text'),
        ('ratio', True, 'takes a number, not the boolean'),
        ('count', 4, 'must be odd 1 to 9, not 4'),
        ('count', 11, 'must be odd 1 to 9, not 11'),
        ('count', 3.0, 'takes a whole number, not the number 3.0'),
        ('count', True, 'takes a whole number'),
        ('mode', 'medium', "must be one of slow, fast, not 'medium'"),
        ('mode', 1, 'takes a text'),
        ('name', 1.5, 'takes a text'),
        ('on', 1, 'takes a boolean'),
        ('on', None, 'takes a boolean, not the NoneType'),
        ('ratio', [1.0], 'takes a number, not the list'),
        ('low', 10, 'must be less than high (10), not 10'),
        ('speed', 1, 'no such parameter; there are ratio, count'),
        ('ration', 1, 'no such parameter; did you mean ratio?'),
    ],
)
def test_bad_values_are_refused_with_the_name_and_the_reason(name, value, reason):
    with pytest.raises(ParameterError) as caught:
        Sample().changed({name: value})
    assert caught.value.name == name
    assert reason in str(caught.value)


@pytest.mark.parametrize('name', ['mode', 'ratio'])
def test_a_long_value_is_refused_in_few_words(name):
    with pytest.raises(ParameterError) as caught:
        Sample().changed({name: 'x' * 5000})
    assert 'xxx' in str(caught.value)
    assert len(str(caught.value)) < 400


def test_numbers_of_numpy_are_taken():
    """As in a loop over np.linspace."""
    for threshold in (np.float64(0.5), np.float32(0.5), np.array(0.5)):
        assert MarkerTrackerParameters(threshold=threshold) == MarkerTrackerParameters(
            threshold=0.5
        )
    mount = np.arange(3.0)
    taken = MarkerTrackerParameters(
        search_radius=np.int64(7), mode=np.str_('detect'), camera_mount_xyz=mount
    )
    assert taken.as_dict() == {
        **MarkerTrackerParameters(mode='detect').as_dict(),
        'search_radius': 7,
        'camera_mount_xyz': (0.0, 1.0, 2.0),
    }
    assert taken.changed({'camera_mount_xyz': tuple(mount)}) == taken
    with pytest.raises(ParameterError, match='takes a whole number, not the number'):
        MarkerTrackerParameters(search_radius=np.float64(0.5))


@pytest.mark.parametrize('kind', [MarkerTrackerParameters, RunwayDetectorParameters])
def test_values_are_taken_by_position_in_the_order_in_which_they_are_listed(kind):
    first = kind.specs()[0]
    other = next(choice for choice in first.choices if choice != first.default)
    assert kind(other) == kind(**{first.name: other})


def test_a_refused_change_leaves_the_old_set():
    before = Sample(ratio=0.75)
    with pytest.raises(ParameterError):
        before.changed({'ratio': 0.1, 'count': 4})
    assert before.ratio == 0.75
    with pytest.raises(dataclasses.FrozenInstanceError):
        before.ratio = 0.1


@pytest.mark.parametrize(
    'kind', [MarkerTrackerParameters, RunwayDetectorParameters, VideoSourceParameters]
)
def test_every_parameter_is_documented_and_its_default_valid(kind):
    assert kind.from_mapping(kind().as_dict()) == kind()
    for spec in kind.specs():
        assert spec.description.endswith('.')
        if spec.type in (int, float):
            # Sliders and refusals need them.
            assert spec.limits is not None


# Users' launch files depend on it; those of runway_detector are in its own test.
CONTRACT = {
    'mode': 'track', 'threshold': 0.7, 'grouping_distance': 15, 'search_radius': 10,
    'min_area': 1, 'max_area': 0,
}  # fmt: skip


def test_the_defaults_are_the_contracts():
    values = MarkerTrackerParameters().as_dict()
    assert {name: values[name] for name in CONTRACT} == CONTRACT


def test_areas_and_frames_that_contradict_are_refused():
    assert MarkerTrackerParameters(min_area=9, max_area=0).max_area == 0
    assert MarkerTrackerParameters(min_area=9, max_area=9).max_area == 9
    with pytest.raises(ParameterError, match=r'max_area: .* at least min_area \(9\), not 8'):
        MarkerTrackerParameters(min_area=9, max_area=8)
    for name in ('body_frame', 'camera_frame', 'base_frame'):
        with pytest.raises(ParameterError, match=f'{name}: must not begin with a slash'):
            MarkerTrackerParameters(**{name: '/tanker'})


def test_a_choice_that_was_a_switch_is_still_set_as_one():
    assert MarkerTrackerParameters(publish_tf=False).publish_tf == 'off'
    assert MarkerTrackerParameters(publish_tf=True).publish_tf == 'camera_to_body'


@pytest.mark.parametrize(
    'text',
    [
        'marker_tracker:\n  ros__parameters:\n    threshold: 0.5\n',
        '/marker_tracker:\n  ros__parameters:\n    threshold: 0.5\n',
        '/nose/marker_tracker:\n  ros__parameters:\n    threshold: 0.5\n',
        'nose:\n  marker_tracker:\n    ros__parameters:\n      threshold: 0.5\n',
        '/**:\n  ros__parameters:\n    threshold: 0.5\n',
        '/**/marker_tracker:\n  ros__parameters:\n    threshold: 0.5\n',
        '/**:\n  ros__parameters:\n    threshold: 0.1\n'
        'marker_tracker:\n  ros__parameters:\n    threshold: 0.5\n',
    ],
)
def test_parameter_files_name_nodes_as_ros_does(text):
    assert parameter_values(text, 'p.yaml', 'marker_tracker') == {'threshold': 0.5}


def test_other_nodes_are_left_alone_and_names_are_nested():
    text = (
        'other:\n  ros__parameters:\n    threshold: 0.5\n'
        'marker_tracker:\n  ros__parameters:\n    a:\n      b: 1\n'
    )
    assert parameter_values(text, 'p.yaml', 'marker_tracker') == {'a.b': 1}


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        ('- 1\n', 'is not a ROS 2 parameter file'),
        ('a: [\n', 'is not YAML'),
        ('marker_tracker:\n  threshold: 1\n', 'has no ros__parameters'),
        ('marker_tracker:\n  ros__parameters: 3\n', 'has no ros__parameters'),
    ],
)
def test_bad_parameter_files_are_refused(text, reason):
    with pytest.raises(ParameterError, match=reason):
        parameter_values(text, 'p.yaml', 'marker_tracker')


def test_a_missing_parameter_file(tmp_path):
    with pytest.raises(ParameterError, match='No such file'):
        load_parameters(tmp_path / 'none.yaml', 'marker_tracker')


@pytest.mark.parametrize(
    ('text', 'parts'),
    [
        ('marker_tracker:threshold:=0.5', ('marker_tracker', 'threshold', 0.5)),
        ('/marker_tracker:mode:=detect', ('marker_tracker', 'mode', 'detect')),
        ('runway_detector:num_peaks:=2', ('runway_detector', 'num_peaks', 2)),
    ],
)
def test_assignments(text, parts):
    assert parse_assignment(text) == parts


@pytest.mark.parametrize('text', ['threshold:=1', 'a:b=1', ':x:=1', 'a::=1', '', 'a:b:=['])
def test_bad_assignments_are_refused(text):
    with pytest.raises(ParameterError):
        parse_assignment(text)


@pytest.mark.parametrize(
    ('parameters', 'useless'),
    [
        (MarkerTrackerParameters(mode='track_any', prediction='velocity'), set()),
        (MarkerTrackerParameters(mode='detect', prediction='none'), {'prediction'}),
        (
            MarkerTrackerParameters(mode='track_any', grouping='distance', grouping_distance=4),
            set(),
        ),
        (MarkerTrackerParameters(mode='track_any', grouping_distance=4), {'grouping_distance'}),
        (
            MarkerTrackerParameters(mode='detect', grouping='components', grouping_distance=4),
            {'grouping_distance'},
        ),
        (MarkerTrackerParameters(grouping='distance'), {'grouping'}),
        (
            RunwayDetectorParameters(mode='approach', max_hold=0, correction_warmup=0),
            {'max_hold', 'correction_warmup'},
        ),
        (
            RunwayDetectorParameters(mode='approach', target='road', min_confidence=0.9),
            {'min_confidence'},
        ),
    ],
)
def test_which_parameters_are_said_to_have_no_effect(parameters, useless):
    assert {*parameters.without_effect()} == useless

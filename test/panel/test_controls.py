"""From a parameter's descriptor, as the nodes publish it, to its control."""

import math

import pytest
from rcl_interfaces.msg import ParameterDescriptor, ParameterType

from mvuav_ros.nodes.live_parameters import _descriptor
from mvuav_ros.panel.controls import Kind, Scale, control_of, scale_of, value_text
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters

TYPES = {
    bool: ParameterType.PARAMETER_BOOL,
    int: ParameterType.PARAMETER_INTEGER,
    float: ParameterType.PARAMETER_DOUBLE,
    str: ParameterType.PARAMETER_STRING,
}
SPECS = [
    pytest.param(spec, id=f'{kind.__name__[:6]}.{spec.name}')
    for kind in (MarkerTrackerParameters, RunwayDetectorParameters)
    for spec in kind.specs()
]


def described(spec):
    """What rclpy makes of the descriptor when the parameter is declared."""
    descriptor = _descriptor(spec)
    descriptor.name, descriptor.type = spec.name, TYPES[spec.type]
    return descriptor


@pytest.mark.parametrize('spec', SPECS)
def test_the_control_says_everything_that_the_declaration_does(spec):
    control = control_of(described(spec))
    assert control.name == spec.name
    assert control.type is spec.type
    assert control.unit == spec.unit
    assert control.thesis == spec.thesis
    assert control.description == spec.description
    assert control.choices == spec.choices
    assert control.odd == spec.odd
    assert control.read_only == spec.read_only
    expected = {bool: Kind.SWITCH, str: Kind.MENU if spec.choices else Kind.TEXT}
    assert control.kind is expected.get(spec.type, Kind.SLIDER)
    if control.kind is Kind.SLIDER:
        assert (control.minimum, control.maximum) == (spec.minimum, spec.maximum)


@pytest.mark.parametrize('spec', [s for s in SPECS if s.values[0].minimum is not None])
def test_every_position_of_a_slider_is_a_value_that_the_node_takes(spec):
    scale = scale_of(control_of(described(spec)))
    values = [scale.value(step / 1000) for step in range(1001)]
    assert values == sorted(values)
    for value in values:
        assert spec.convert(value) == value
    assert values[0] == pytest.approx(spec.minimum, abs=1)
    assert values[-1] == spec.maximum
    assert scale.value(scale.position(spec.default)) == pytest.approx(spec.default, rel=0.01)


def test_a_wide_range_is_fine_at_its_lower_end_and_ends_at_the_image():
    scale = Scale(0, 100_000, whole=True)
    assert sum(scale.value(step / 1000) < 1000 for step in range(1001)) > 400
    rows = scale.within(240)
    assert [rows.value(position) for position in (0, 0.25, 0.5, 1)] == [0, 60, 120, 240]
    assert scale.within(0) == scale


def test_what_is_typed_becomes_a_value_or_is_refused():
    number = control_of(described(MarkerTrackerParameters.spec('threshold')))
    assert number.parse(' 0,55 ') == 0.55
    assert math.isnan(number.parse('nan'))
    whole = control_of(described(MarkerTrackerParameters.spec('search_radius')))
    assert whole.parse('12') == 12 and type(whole.parse('12')) is int
    for words in ('1.5', '', 'ten', 'inf', None):
        with pytest.raises(ValueError):
            whole.parse(words)


def test_other_nodes_descriptors_do_no_harm():
    bare = control_of(ParameterDescriptor(name='gain', type=ParameterType.PARAMETER_DOUBLE))
    assert (bare.kind, bare.description, bare.unit) == (Kind.NUMBER, '', '')
    array = control_of(ParameterDescriptor(name='list', type=ParameterType.PARAMETER_DOUBLE_ARRAY))
    assert array.read_only and array.kind is Kind.TEXT
    strange = ParameterDescriptor(
        name='x', type=ParameterType.PARAMETER_STRING, description='<b>Unit: px.</b>\n Thesis: '
    )
    assert control_of(strange).description == '<b>Unit: px.</b>\n Thesis:'


def test_values_in_words():
    shown = [value_text(value) for value in (True, False, 0.1 + 0.2, 15, 'track', '', None)]
    assert shown == ['on', 'off', '0.3', '15', 'track', '(empty)', '-']

"""From a parameter's descriptor, as the nodes publish it, to its control."""

import pytest
from rcl_interfaces.msg import ParameterDescriptor, ParameterType

from mvuav_ros.nodes.live_parameters import _descriptor
from mvuav_ros.panel.controls import Kind, control_of, position_on, scale_of, value_text
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters

MARKUP = '<img src=x onerror=alert(1)>'
TYPES = {
    bool: ParameterType.PARAMETER_BOOL,
    int: ParameterType.PARAMETER_INTEGER,
    float: ParameterType.PARAMETER_DOUBLE,
    str: ParameterType.PARAMETER_STRING,
    tuple: ParameterType.PARAMETER_DOUBLE_ARRAY,
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
    said = control.text
    assert (said.unit, said.thesis, said.description) == (spec.unit, spec.thesis, spec.description)
    assert (said.usual, said.stage, said.counts) == (spec.usual, spec.stage, spec.counts)
    assert said.default == value_text(spec.default)
    assert control.choices == spec.choices
    assert control.odd == spec.odd
    assert control.read_only == spec.read_only
    text = Kind.MENU if spec.choices else Kind.TEXT
    expected = {bool: Kind.SWITCH, str: text, tuple: Kind.TEXT}
    assert control.kind is expected.get(spec.type, Kind.SLIDER)
    if control.kind is Kind.SLIDER:
        assert (control.minimum, control.maximum) == (spec.minimum, spec.maximum)


SLIDERS = [s for s in SPECS if s.values[0].type in (int, float)]


@pytest.mark.parametrize('spec', SLIDERS)
def test_every_position_of_a_slider_is_a_value_that_the_node_takes(spec):
    values = scale_of(control_of(described(spec)))
    assert list(values) == sorted(set(values)) and 5 <= len(values) <= 600
    for value in values:
        assert spec.convert(value) == value


@pytest.mark.parametrize('spec', SLIDERS)
def test_a_slider_spans_what_is_usual_and_a_hand_can_set_the_default(spec):
    scale = scale_of(control_of(described(spec)))
    low, high = spec.usual
    assert spec.minimum <= low <= spec.default <= high <= spec.maximum
    assert scale[0] == pytest.approx(low) and scale[-1] == pytest.approx(high)
    place = position_on(scale, spec.default)
    assert scale[place] == pytest.approx(spec.default)
    # Not squeezed into a corner, unless the default is the end of the range.
    assert spec.default == low or place >= 0.02 * len(scale)


def test_fine_values_of_a_wide_range_can_be_reached():
    rho = scale_of(control_of(described(RunwayDetectorParameters.spec('rho_resolution'))))
    assert {0.25, 0.5, 1.5, 2.0, 10.0} <= set(rho)
    assert 60 < position_on(rho, 1.5) < 140


def test_places_end_where_the_image_does():
    control = control_of(described(RunwayDetectorParameters.spec('end_row')))
    assert scale_of(control, 240)[-1] == 240
    assert scale_of(control, 0)[-1] == 1080


def test_what_has_an_effect_depends_on_the_other_values():
    grouping = control_of(described(MarkerTrackerParameters.spec('grouping_distance')))
    assert not grouping.counts({'mode': 'track', 'prediction': 'kalman'})
    assert grouping.counts({'mode': 'track', 'prediction': 'velocity'})
    assert grouping.counts({'mode': 'detect', 'prediction': 'kalman'})
    assert not grouping.counts({'mode': 'track_any', 'prediction': 'none'})
    for name in RunwayDetectorParameters.names():
        control = control_of(described(RunwayDetectorParameters.spec(name)))
        modes = [mode for mode in ('thesis', 'approach') if control.counts({'mode': mode})]
        assert modes, name


def test_what_is_typed_becomes_a_value_or_is_refused():
    number = control_of(described(MarkerTrackerParameters.spec('threshold')))
    assert number.parse(' 0,55 ') == 0.55
    for words in ('nan', 'inf', 'ten', ''):
        with pytest.raises(ValueError):
            number.parse(words)
    whole = control_of(described(MarkerTrackerParameters.spec('search_radius')))
    assert whole.parse('12') == 12 and type(whole.parse('12')) is int
    for words in ('1.5', '', 'ten', 'inf', '1e30', None):
        with pytest.raises(ValueError):
            whole.parse(words)
    several = control_of(described(RunwayDetectorParameters.spec('camera_mount_rpy_deg')))
    for words in ('0, -10.5, 3', '0 -10.5 3', '[0; -10.5; 3]', value_text((0.0, -10.5, 3.0))):
        assert several.parse(words) == (0.0, -10.5, 3.0)
    for words in ('', 'nan, 0, 0', '1, two, 3', MARKUP):
        with pytest.raises(ValueError):
            several.parse(words)


def test_other_nodes_descriptors_do_no_harm():
    bare = control_of(ParameterDescriptor(name='gain', type=ParameterType.PARAMETER_DOUBLE))
    assert (bare.kind, bare.text.description, bare.text.unit) == (Kind.NUMBER, '', '')
    array = control_of(ParameterDescriptor(name='list', type=ParameterType.PARAMETER_STRING_ARRAY))
    assert array.read_only and array.kind is Kind.TEXT
    strange = ParameterDescriptor(
        name='x', type=ParameterType.PARAMETER_STRING, description='<b>Unit: px.</b>\n Thesis: '
    )
    assert control_of(strange).text.description == '<b>Unit: px.</b> Thesis:'


def test_values_in_words():
    values = (True, False, 0.1 + 0.2, 15, 'track', '', None, (1.0, -0.5))
    shown = [value_text(value) for value in values]
    assert shown == ['on', 'off', '0.3', '15', 'track', '(empty)', '-', '1, -0.5']

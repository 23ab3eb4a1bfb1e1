"""From the declaration of a parameter to its control."""

import pytest

from mvuav_ros.panel.controls import EVERY_NODE, controls_of, position_on, scale_of, value_text
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters

MARKUP = '<img src=x onerror=alert(1)>'


def control_of(kind, name):
    (control,) = controls_of(kind, {name: kind.spec(name).default})
    return control


CONTROLS = [
    pytest.param(control, id=f'{kind.__name__[:6]}.{control.name}')
    for kind in (MarkerTrackerParameters, RunwayDetectorParameters)
    for control in controls_of(kind, kind().as_dict())
]


@pytest.mark.parametrize('control', CONTROLS)
def test_the_widget_fits_the_declaration(control):
    text = 'menu' if control.choices else 'text'
    expected = {bool: 'switch', str: text, tuple: 'text'}
    assert control.kind == expected.get(control.type, 'slider')
    if control.type in (int, float, tuple):
        assert control.parse(value_text(control.default)) == control.default
    assert control.declared and control.stage != EVERY_NODE


def test_controls_stand_in_the_order_in_which_the_node_has_its_parameters():
    values = {'use_sim_time': False, **MarkerTrackerParameters().as_dict()}
    assert [c.name for c in controls_of(MarkerTrackerParameters, values)] == list(values)


SLIDERS = [c for c in CONTROLS if c.values[0].kind == 'slider']


@pytest.mark.parametrize('spec', SLIDERS)
def test_every_position_of_a_slider_is_a_value_that_the_node_takes(spec):
    values = scale_of(spec)
    assert list(values) == sorted(set(values)) and 5 <= len(values) <= 600
    for value in values:
        assert spec.convert(value) == value


@pytest.mark.parametrize('spec', SLIDERS)
def test_a_slider_spans_what_is_usual_and_a_hand_can_set_the_default(spec):
    scale = scale_of(spec)
    low, high = spec.usual
    assert spec.limits[0] <= low <= spec.default <= high <= spec.limits[1]
    assert scale[0] == pytest.approx(low) and scale[-1] == pytest.approx(high)
    place = position_on(scale, spec.default)
    assert scale[place] == pytest.approx(spec.default)
    # Not squeezed into a corner, unless the default is the end of the range.
    assert spec.default == low or place >= 0.02 * len(scale)


def test_fine_values_of_a_wide_range_can_be_reached():
    rho = scale_of(control_of(RunwayDetectorParameters, 'rho_resolution'))
    assert {0.25, 0.5, 1.5, 2.0, 10.0} <= set(rho)
    assert 60 < position_on(rho, 1.5) < 140


def test_places_end_where_the_image_does():
    control = control_of(RunwayDetectorParameters, 'end_row')
    assert scale_of(control, 240)[-1] == 240
    assert scale_of(control, 0)[-1] == 1080
    # An image smaller than anything usual leaves two values.
    assert scale_of(control_of(MarkerTrackerParameters, 'min_area'), 1) == (1, 2)


def test_what_has_an_effect_depends_on_the_other_values():
    grouping = control_of(MarkerTrackerParameters, 'grouping_distance')
    markers, runway = MarkerTrackerParameters().as_dict(), RunwayDetectorParameters().as_dict()
    assert not grouping.has_effect({**markers, 'mode': 'track', 'prediction': 'kalman'})
    assert grouping.has_effect({**markers, 'mode': 'track', 'prediction': 'velocity'})
    assert grouping.has_effect({**markers, 'mode': 'detect', 'prediction': 'kalman'})
    assert not grouping.has_effect({**markers, 'mode': 'track_any', 'prediction': 'none'})
    for name in RunwayDetectorParameters.names():
        control = control_of(RunwayDetectorParameters, name)
        modes = [
            mode for mode in ('thesis', 'approach') if control.has_effect({**runway, 'mode': mode})
        ]
        assert modes, name


def test_what_is_typed_becomes_a_value_or_is_refused():
    number = control_of(MarkerTrackerParameters, 'threshold')
    assert number.parse(' 0,55 ') == 0.55
    for words in ('nan', 'inf', 'ten', ''):
        with pytest.raises(ValueError):
            number.parse(words)
    whole = control_of(MarkerTrackerParameters, 'search_radius')
    assert whole.parse('12') == 12 and type(whole.parse('12')) is int
    for words in ('1.5', '', 'ten', 'inf', '1e30', None, '10,000'):
        with pytest.raises(ValueError):
            whole.parse(words)
    several = control_of(RunwayDetectorParameters, 'camera_mount_rpy_deg')
    for words in ('0, -10.5, 3', '0 -10.5 3', '[0; -10.5; 3]', value_text((0.0, -10.5, 3.0))):
        assert several.parse(words) == (0.0, -10.5, 3.0)
    for words in ('', 'nan, 0, 0', '1, two, 3', MARKUP):
        with pytest.raises(ValueError):
            several.parse(words)


def test_what_is_not_declared_has_the_type_of_its_value():
    values = {
        'gain': 1.5,
        'words': MARKUP,
        'nothing': None,
        'use_sim_time': False,
        'qos_overrides./x.publisher.depth': 10,
    }
    gain, words, nothing, clock, depth = controls_of(MarkerTrackerParameters, values)
    assert (gain.kind, gain.parse('2'), gain.stage) == ('number', 2.0, 'Other')
    assert (words.kind, words.read_only, words.declared) == ('text', False, False)
    assert (words.parse(' a, b '), words.parse(3), words.parse(None)) == (' a, b ', '3', '')
    assert nothing.read_only
    assert clock.stage == depth.stage == EVERY_NODE
    assert clock.kind == 'switch' and not clock.read_only
    assert depth.read_only


def test_values_in_words():
    values = (True, False, 0.1 + 0.2, 15, 'track', '', None, (1.0, -0.5))
    shown = [value_text(value) for value in values]
    assert shown == ['on', 'off', '0.3', '15', 'track', '(empty)', '-', '1, -0.5']

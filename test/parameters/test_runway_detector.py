"""What runway_detector's parameters accept and refuse."""

import math

import pytest

from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters as Parameters

CONTRACT = {
    'mode': 'thesis',
    'target': 'runway',
    'runway_width': 0.0,
    'integrity_risk': 0.05,
    'alert_limit': (0.0, 0.0),
    'start_row': 50,
    'end_row': 130,
    'channel': 'red',
    'edge_threshold': 0.0,
    'edge_thinning': False,
    'opening_shape': 'vertical_line',
    'opening_length': 3,
    'rho_resolution': 2.0,
    'theta_resolution_deg': 1.0,
    'num_peaks': 3,
    'peak_neighborhood_rho': 11,
    'peak_neighborhood_theta': 11,
    'peak_threshold': 15,
    'rho_error_threshold': 30.0,
    'theta_error_threshold_deg': 2.0,
    'correction_warmup': 2,
    'max_hold': 15,
    'association': 'nearest',
    'image_transport': 'raw',
    'image_is_rectified': False,
    'opencv_threads': 1,
    'autostart': True,
    'publish_tf': 'camera_to_body',
    'camera_frame': '',
    'base_frame': '',
    'camera_mount_xyz': (0.0, 0.0, 0.0),
    'runway_frame': 'runway',
    'min_confidence': 0.5,
    'horizon_source': 'auto',
    'camera_mount_rpy_deg': (0.0, 0.0, 0.0),
}


def test_names_and_defaults_are_the_contracts():
    assert Parameters().as_dict() == CONTRACT


@pytest.mark.parametrize(
    ('name', 'value', 'reason'),
    [
        ('peak_neighborhood_rho', 10, 'odd'),
        ('peak_neighborhood_theta', 4, 'odd'),
        ('opening_length', 2, 'odd'),
        ('opening_length', 0, 'odd'),
        ('opening_shape', 'round', 'vertical_line'),
        ('rho_resolution', 0.0, '0.1'),
        ('theta_resolution_deg', 0.0, '0.1'),
        ('theta_resolution_deg', 46.0, '45'),
        ('rho_resolution', math.nan, 'finite'),
        ('edge_threshold', math.inf, 'finite'),
        ('edge_threshold', -0.1, '0 to 1'),
        ('rho_error_threshold', math.nan, 'finite'),
        ('end_row', 50, 'greater than start_row'),
        ('end_row', 0, 'greater than start_row'),
        ('start_row', 130, 'greater than start_row'),
        ('start_row', -1, '0'),
        ('num_peaks', 0, '1'),
        ('peak_threshold', 0, '1'),
        ('peak_threshold', 15.0, 'whole number'),
        ('channel', 'alpha', 'red, green, blue, intensity'),
        ('association', 'order', 'index, nearest'),
        ('edge_thinning', 1, 'boolean'),
        ('max_hold', -1, '0'),
        ('mode', 'both', 'thesis, approach'),
        ('target', 'river', 'runway'),
        ('runway_width', -1.0, '0'),
    ],
)
def test_invalid_values_are_refused_with_the_reason(name, value, reason):
    with pytest.raises(ParameterError, match=reason):
        Parameters().changed({name: value})


def test_both_rows_zero_mean_the_whole_frame_and_are_set_together():
    assert Parameters().changed({'start_row': 0, 'end_row': 0}).end_row == 0
    assert Parameters().changed({'start_row': 200, 'end_row': 240}).start_row == 200


@pytest.mark.parametrize('shape', ['disk', 'diamond'])
def test_round_elements_are_bounded_and_straight_ones_are_not(shape):
    Parameters(opening_shape=shape, opening_length=31)
    with pytest.raises(ParameterError, match='at most 31'):
        Parameters(opening_shape=shape, opening_length=33)
    Parameters(opening_shape='square', opening_length=999)

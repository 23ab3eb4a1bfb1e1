import math

import numpy as np
import pytest

from mvuav_ros.offline.evaluation.evaluation_run import EvaluationRun, Observations
from mvuav_ros.offline.evaluation.metrics import (
    TrueLine,
    distance_rms,
    match_lines,
    metrics_of,
    rms,
)
from mvuav_ros.vision.runway.normal_form import NormalForm as Line
from mvuav_thesis.comparison import pooled_rms, spectrum


def test_rms_of_distances_by_hand():
    errors = np.array([[3.0, 4.0], [0.0, 0.0], [math.nan, 9.0], [0.0, 5.0]])
    assert distance_rms(errors) == pytest.approx(math.sqrt((25 + 0 + 25) / 3))
    assert rms(np.array([1.0, math.nan, -1.0])) == 1.0
    assert math.isnan(rms(np.array([math.nan])))


@pytest.mark.parametrize(
    ('rolls', 'mean', 'std'),
    [
        ([10.0, 12.0, 17.0], 13.0, 3.606),
        ([-179.0, 179.0, 177.0], 179.0, 2.0),
        # Two frames with the wings exchanged on either side of the circle leave no full turn.
        ([0.0, 178.0, -178.0, 0.0, 2.0, -2.0], 0.0, 112.58),
    ],
    ids=['plain', 'through 180', 'exchanged for two frames'],
)
def test_the_mean_roll_is_on_the_circle(rolls, mean, std):
    results = Observations(rpy=dict(enumerate(np.radians(rolls).tolist())))
    said = {metric.name: metric.value for metric in metrics_of(EvaluationRun('a', results))}
    assert said['roll mean'] == pytest.approx(mean, abs=1e-9)
    assert said['roll std'] == pytest.approx(std, abs=0.01)


def test_pooled_rms_covers_the_true_value():
    rng = np.random.default_rng(1)
    covered = 0
    for _ in range(200):
        interval = pooled_rms([rng.normal(0.0, 2.0, 60) for _ in range(10)])
        assert interval.low < interval.value < interval.high
        covered += interval.low <= 2.0 <= interval.high
    assert 180 <= covered <= 199


def test_one_flight_has_no_interval():
    interval = pooled_rms([np.array([3.0, -3.0])])
    assert interval.value == 3.0
    assert math.isnan(interval.low)
    assert interval.text(2) == '3.00'


@pytest.mark.parametrize(('frequency', 'amplitude'), [(2.5, 0.8), (7.0, 3.0)])
def test_spectrum_shows_the_vibration(frequency, amplitude):
    time = np.arange(1800) / 30.0
    rng = np.random.default_rng(3)
    values = 5.0 + amplitude * np.sin(2 * np.pi * frequency * time) + rng.normal(0, 0.05, 1800)
    density = spectrum(values, 30.0)
    assert density.peaks(1) == pytest.approx([frequency], abs=0.1)
    assert density.amplitude(frequency, 0.5) == pytest.approx(amplitude, rel=0.02)
    assert density.amplitude(frequency + 3.0, 0.5) < 0.05


def true_line(theta, rho, along=0.0):
    x = rho * math.cos(theta) - along * math.sin(theta)
    y = rho * math.sin(theta) + along * math.cos(theta)
    return TrueLine(Line(rho, theta), (x, y))


def test_lines_match_the_nearest_once():
    true = [true_line(0.2, 100.0), true_line(0.2, 106.0)]
    found = [Line(104.5, 0.2), Line(101.0, 0.2), Line(105.8, 0.21), Line(math.nan, math.nan)]
    matches = {(m.found, m.true) for m in match_lines(found, true)}
    assert matches == {(1, 0), (2, 1)}


def test_a_line_matches_itself_written_the_other_way():
    (match,) = match_lines([Line(-50.0, -math.pi / 2 + 0.01)], [true_line(math.pi / 2, 50.0)])
    assert match.dtheta == pytest.approx(0.01)
    assert abs(match.distance) < 0.01


@pytest.mark.parametrize('line', [Line(105.2, 0.2), Line(100.0, 0.2 + math.radians(3.5))])
def test_a_line_too_far_off_matches_nothing(line):
    assert match_lines([line], [true_line(0.2, 100.0)]) == []

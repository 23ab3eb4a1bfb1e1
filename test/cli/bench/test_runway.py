"""The cases of `mvuav bench`: both sides must do the same work."""

import json

import numpy as np
import pytest
from support.commands import mvuav

from mvuav_ros.cli.bench import cases as runway
from mvuav_ros.cli.bench.cases import Case
from mvuav_ros.vision.runway.detector import RunwayDetector
from mvuav_ros.vision.runway.edges import automatic_threshold


def test_cases_run_and_carry_their_limits():
    cases = runway.runway_cases()
    limits = {(case.name, case.baseline_name): case.limit_ratio for case in cases}
    assert limits['runway 320x240 rows 50-130', 'OpenCV'] == 1.5
    assert limits['runway 1280x720 whole frame', 'OpenCV'] is None
    for case in cases:
        assert case.run().status == ''
        assert case.baseline() is not None


def test_all_sides_find_the_same_strongest_line():
    frame = runway._runway(320, 240, 3)
    ours = RunwayDetector().process(frame, 0).workings
    strongest = ours.peaks[0]
    theta, rho = ours.grid.theta[strongest.theta_index], ours.grid.rho[strongest.rho_index]
    gray = np.ascontiguousarray(frame[50:130, :, 2])
    rho_cv, theta_cv = np.reshape(runway._opencv(gray, automatic_threshold(gray)), (-1, 2))[0]
    if theta_cv > np.pi / 2:
        rho_cv, theta_cv = -rho_cv, theta_cv - np.pi
    assert abs(theta_cv - theta) < np.deg2rad(2.5) and abs(rho_cv - rho) < 5


def test_scikit_image_finds_the_same_strongest_line():
    pytest.importorskip('skimage')
    frame = runway._runway(320, 240, 3)
    ours = RunwayDetector().process(frame, 0).workings
    strongest = ours.peaks[0]
    gray = np.ascontiguousarray(frame[50:130, :, 2])
    _, theta, rho = runway._scikit_image()(gray, automatic_threshold(gray))
    assert abs(theta[0] - ours.grid.theta[strongest.theta_index]) < np.deg2rad(2.5)
    assert abs(rho[0] - ours.grid.rho[strongest.rho_index]) < 5


def test_the_numbers_go_into_a_folder_that_is_not_there_yet(tmp_path, monkeypatch):
    monkeypatch.setattr(runway, 'simulation_cases', lambda: [Case('nothing', lambda: None)])
    path = tmp_path / 'new' / 'bench.json'
    assert mvuav('bench', 'simulation', '--seconds', '0.01', '--json', path).status == 0
    assert [figures['case'] for figures in json.loads(path.read_text())] == ['nothing']

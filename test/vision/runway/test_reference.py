"""Against Octave's own edges, accumulator and peaks."""

import numpy as np
import pytest
from support.reference import FIRST, LAST, load_runway

from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.vision.runway.detector import RunwayDetector
from mvuav_ros.vision.runway.edges import automatic_threshold, detect_edges, open_edges
from mvuav_ros.vision.runway.hough import HoughGrid
from mvuav_ros.vision.runway.peaks import find_peaks

VARIANTS = [
    pytest.param(True, 'edge', 'opened', 'peaks', id='thinned'),
    pytest.param(False, 'edge_nothin', 'opened_nothin', 'peaks_nothin', id='not thinned'),
]


@pytest.fixture(scope='module')
def octave():
    return load_runway()


@pytest.fixture(scope='module')
def slices(octave):
    return [np.ascontiguousarray(frame[FIRST:LAST, :, 0]) for frame in octave['rgb']]


def peaks_of(edges, rho_resolution):
    grid = HoughGrid(*edges.shape, rho_resolution, 1.0)
    accumulator = grid.accumulate(np.ascontiguousarray(edges).view(np.uint8))
    half = 0.5 * float(accumulator.max())
    peaks = find_peaks(accumulator, 3, half, 11, 11, grid.first_reachable_cell)
    lines = [(grid.rho[p.rho_index], np.rad2deg(grid.theta[p.theta_index])) for p in peaks]
    return np.array(lines), [p.votes for p in peaks]


@pytest.mark.parametrize(('thinning', 'edge_key', 'opened_key', 'peaks_key'), VARIANTS)
def test_no_pixel_of_any_edge_image_differs(
    octave, slices, thinning, edge_key, opened_key, peaks_key
):
    assert len(slices) == 60
    for gray, edge, opened in zip(slices, octave[edge_key], octave[opened_key], strict=True):
        edges = detect_edges(gray, thinning=thinning)
        assert np.count_nonzero(edges != edge) == 0
        assert np.count_nonzero(open_edges(edges, 'vertical_line', 3) != opened) == 0


def test_the_automatic_threshold_is_octaves(octave, slices):
    thresholds = [automatic_threshold(gray) for gray in slices]
    np.testing.assert_allclose(thresholds, octave['sobel_thresh'], rtol=1e-14)


def test_octaves_threshold_given_as_a_number_finds_the_same_edges(octave, slices):
    for gray, threshold, edge in zip(
        slices, octave['sobel_thresh'], octave['edge_nothin'], strict=True
    ):
        assert np.count_nonzero(detect_edges(gray, float(threshold)) != edge) == 0


def test_the_accumulator_is_octaves(octave):
    grid = HoughGrid(81, 320, 2.0, 1.0)
    np.testing.assert_array_equal(grid.rho, octave['rho'])
    np.testing.assert_allclose(np.rad2deg(grid.theta), octave['theta'], atol=1e-12)
    accumulator = grid.accumulate(octave['opened'][0].view(np.uint8))
    unreachable, reachable = np.split(octave['H_frame1'], [grid.first_reachable_cell])
    assert not unreachable.any()
    np.testing.assert_array_equal(accumulator.T, reachable)


def test_the_same_votes(octave):
    for opened, expected in zip(octave['opened'], octave['votes'], strict=True):
        assert peaks_of(opened, 2.0)[1] == list(expected)


def test_the_same_peaks_as_octaves_own_hough_at_one_pixel(octave):
    for opened, expected in zip(octave['opened'], octave['peaks_res1'], strict=True):
        lines, _ = peaks_of(opened, 1.0)
        np.testing.assert_allclose(lines, expected, atol=1e-12)


@pytest.mark.parametrize(('thinning', 'edge_key', 'opened_key', 'peaks_key'), VARIANTS)
def test_the_pipeline_reports_octaves_peaks_on_the_whole_frame(
    octave, thinning, edge_key, opened_key, peaks_key
):
    pipeline = RunwayDetector(
        RunwayDetectorParameters(
            start_row=FIRST,
            end_row=LAST,
            edge_thinning=thinning,
            association='index',
            peak_threshold=1,
        )
    )
    for number, rgb in enumerate(octave['rgb']):
        result = pipeline.process(np.ascontiguousarray(rgb[:, :, ::-1]), number)
        rho, theta = octave[peaks_key][number].T
        theta = np.deg2rad(theta)
        assert [line.theta_raw for line in result.lines] == pytest.approx(theta)
        assert [line.rho_raw for line in result.lines] == pytest.approx(rho + FIRST * np.sin(theta))


def test_the_pipeline_finds_the_painted_lines_as_well_as_octave_does(octave):
    """The README's 1.47 px rms across at mid-slice and 0.88° rms, on the whole frame."""
    pipeline = RunwayDetector(
        RunwayDetectorParameters(start_row=FIRST, end_row=LAST, edge_thinning=True)
    )
    middle = 40
    across, turn = [], []
    for number, rgb in enumerate(octave['rgb']):
        result = pipeline.process(np.ascontiguousarray(rgb[:, :, ::-1]), number)
        truth_rho, truth_theta = octave['truth'][number].T
        truth_theta = np.deg2rad(truth_theta)
        truth_x = (truth_rho - middle * np.sin(truth_theta)) / np.cos(truth_theta)
        for line in result.lines:
            row = FIRST + middle
            x = (line.rho_raw - row * np.sin(line.theta_raw)) / np.cos(line.theta_raw)
            nearest = np.argmin(np.abs(truth_theta - line.theta_raw))
            across.append(x - truth_x[nearest])
            turn.append(np.rad2deg(line.theta_raw - truth_theta[nearest]))
    assert np.sqrt(np.mean(np.square(across))) == pytest.approx(1.47, abs=0.02)
    assert np.sqrt(np.mean(np.square(turn))) == pytest.approx(0.88, abs=0.02)

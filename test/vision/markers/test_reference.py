"""Appendices A and C against the thesis's own programs, run under Octave."""

import numpy as np
import pytest
from support.reference import load_trial

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.lights import group_mask
from mvuav_ros.vision.markers.marker_results import MarkerState
from mvuav_ros.vision.markers.tracker import MarkerTracker
from mvuav_ros.vision.point_operations import threshold

TRIALS = sorted(f'trial{n}' for n in (1, 3))


@pytest.fixture(scope='module', params=TRIALS)
def trial(request):
    return load_trial(request.param)


@pytest.fixture(scope='module')
def frames(trial):
    """All 150 thresholded frames: bright pixels 255, the rest 0."""
    return np.unpackbits(trial['mask_packed'], axis=-1) * np.uint8(255)


def run(frames, **parameters):
    pipeline = MarkerTracker(MarkerTrackerParameters.from_mapping(parameters))
    return [
        pipeline.process(Image(frame, 'mono8'), round(index / 15 * 1e9))
        for index, frame in enumerate(frames)
    ]


def positions(results):
    return np.array([[(m.x, m.y) for m in result.markers] for result in results])


def by_label(values, labels):
    """The program's rows, in scan order, in the order of the labels (1-based scan indices)."""
    return np.take_along_axis(values, labels[..., None].astype(int) - 1, axis=1)


def test_threshold_of_grey_frames_equals_the_program(trial):
    for grey, mask in zip(trial['frames'], trial['mask_packed'], strict=False):
        assert (threshold(grey, 0.7) > 0).tolist() == np.unpackbits(mask, axis=-1).tolist()


def test_detect_gives_appendix_a(trial, frames):
    results = run(frames, mode='detect')
    expected = by_label(trial['A_xy'], trial['A_labels']) - 1
    assert len(results) == 150
    np.testing.assert_allclose(positions(results), expected, atol=1e-3)
    rolls = np.degrees([result.roll for result in results])
    np.testing.assert_allclose(rolls, trial['A_phi_deg'], atol=1e-3)
    areas = np.array([[m.area for m in result.markers] for result in results])
    labels = trial['A_labels'].astype(int) - 1
    np.testing.assert_array_equal(areas, np.take_along_axis(trial['A_count'], labels, axis=1))


def test_detect_any_finds_what_appendix_b_finds_where_that_ends(trial, frames):
    results = run(frames, mode='detect_any')
    ended = trial['B_status'] == 0
    assert ended.sum() >= 100
    for result, expected in zip(
        np.array(results, object)[ended], trial['B_xy'][ended], strict=True
    ):
        found = np.array([(m.x, m.y) for m in result.markers])
        np.testing.assert_allclose(found, expected[:5] - 1, atol=1e-3)


def test_detect_any_ends_where_appendix_b_loops_for_ever(trial, frames):
    for index in np.nonzero(trial['B_status'] != 0)[0]:
        (result,) = run(frames[index : index + 1], mode='detect_any')
        assert len(result.markers) == 5


@pytest.mark.parametrize(
    ('prediction', 'program'),
    [('velocity', 'C_velocity_fixdt'), ('acceleration_program', 'C_full_fixdt')],
)
def test_track_gives_appendix_c(trial, frames, prediction, program):
    results = run(frames, mode='track', prediction=prediction)
    labels = np.tile(trial[f'{program}_labels'], (150, 1))
    np.testing.assert_allclose(
        positions(results), by_label(trial[f'{program}_act_xy'], labels) - 1, atol=1e-3
    )
    np.testing.assert_allclose(
        np.degrees([r.roll for r in results]), trial[f'{program}_phi_deg'], atol=1e-3
    )
    assert all(not result.windows for result in results[:3])
    np.testing.assert_array_equal(
        np.array([result.windows for result in results[3:]]),
        by_label(trial[f'{program}_window'], labels)[3:] - 1,
    )


@pytest.mark.parametrize('prediction', ['none', 'velocity', 'acceleration'])
def test_track_never_loses_a_marker_of_the_trials(trial, frames, prediction):
    results = run(frames, mode='track', prediction=prediction)
    assert all(m.state is MarkerState.DETECTED for r in results for m in r.markers)
    assert all(result.status == '' for result in results)


def test_acceleration_follows_the_equations(trial, frames):
    """Eq. 4.2 with equal steps: x + 1.5 d1 - 0.5 d0."""
    results = run(frames, mode='track', prediction='acceleration')
    x = positions(results)
    expected = x[2:-1] + 1.5 * (x[2:-1] - x[1:-2]) - 0.5 * (x[1:-2] - x[:-3])
    windows = np.array([result.windows for result in results[3:]])
    centres = windows[:, :, [0, 2]] + 10
    assert np.abs(centres - expected).max() <= 0.5 + 1e-4


def test_grouping_is_the_programs_to_the_letter(trial, frames):
    """An independent, naive transcription of the grouping, on masks thinned at random."""
    rng = np.random.default_rng(1)
    for frame in frames[::30]:
        mask = np.where(rng.random(frame.shape) < 0.7, frame, 0).astype(np.uint8)
        mask[rng.integers(0, 480, 20), rng.integers(0, 640, 20)] = 255
        left = sorted((int(x), int(y)) for y, x in zip(*np.nonzero(mask), strict=True))
        expected = []
        while left:
            seed_x, seed_y = left[0]
            group = [(x, y) for x, y in left if x <= seed_x + 15 and abs(y - seed_y) <= 15]
            left = [pixel for pixel in left if pixel not in group]
            expected.append((*np.mean(group, axis=0), len(group)))
        np.testing.assert_allclose(group_mask(mask, 15), expected, atol=1e-9)

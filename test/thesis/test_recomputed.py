"""Numbers of each table computed again from the raw data, by other means."""

import math
import statistics

import numpy as np
import pytest

from mvuav_ros.simulation.runway_flight import RunwayFlight
from mvuav_ros.simulation.shake import ROLL_DEG_PER_MAGNITUDE, VIBRATIONS, Shake
from mvuav_ros.vision.approach.approach_detector import ApproachDetector
from mvuav_ros.vision.runway.detector import RunwayDetector
from mvuav_thesis import known
from mvuav_thesis.plan import RUNS, Plan
from mvuav_thesis.runway import (
    APPROACH,
    approach_table,
    figure_4_30,
    flags_table,
    fly_runway,
    found_table,
    runway_tasks,
)
from mvuav_thesis.runway_stages import THESIS_YAML
from mvuav_thesis.stages import time_programs, trial_images
from mvuav_thesis.tracking_figures import mean_and_deviation
from mvuav_thesis.tracking_trials import (
    found_table as places_table,
)
from mvuav_thesis.tracking_trials import predicted_table, table_5_3, vibration_table
from mvuav_thesis.trials import fly_markers, tracking_tasks, trials_of
from mvuav_thesis.vibration import cells_of, measure, roll_tables, roll_tasks, table_5_4

PLAN = Plan(
    seed=9,
    jobs=1,
    trial_seconds=1.6,
    trial_repeats=2,
    passes=1,
    repeats=2,
    measurements=6,
    runway_seconds=1.2,
)


def root_mean_square(numbers):
    numbers = [n for n in numbers if not math.isnan(n)]
    return math.sqrt(math.fsum(n * n for n in numbers) / len(numbers))


def distances(a, b):
    return [math.dist(p, q) for p, q in zip(a.tolist(), b.tolist(), strict=True)]


@pytest.fixture(scope='module')
def flown():
    return trials_of([fly_markers(task) for task in tracking_tasks(PLAN)])


@pytest.mark.parametrize(
    ('trial', 'row', 'method', 'marker'),
    [(1, 1, 'velocity', 0), (2, 3, 'acceleration_program', 2), (4, 5, 'as shipped', 4)],
)
def test_table_5_3(flown, trial, row, method, marker):
    trials, _ = flown
    errors = []
    for flight in trials[trial - 1].flights:
        run = flight.runs[method]
        errors += distances(run.predicted[:, marker], run.found[:, marker])
    cell = table_5_3(trials).rows[6 * (trial - 1) + row][3 + marker]
    assert cell.value == pytest.approx(root_mean_square(errors))


def test_every_method_is_judged_by_the_same_frames(flown):
    trials, shaken = flown
    for flight in [*(f for trial in trials for f in trial.flights), *shaken]:
        for method in RUNS:
            known_at = np.isfinite(flight.runs[method].prediction_error).all(axis=(1, 2))
            assert not known_at[:3].any() and known_at[3:].all(), method


@pytest.mark.parametrize(('row', 'method'), [(1, 'velocity'), (6, 'kalman'), (15, 'none')])
def test_vibration(flown, row, method):
    trials, shaken = flown
    flight = [f for f in shaken if f.settings.motion == trials[row // 4].first.settings.motion][
        row % 4 - 1
    ]
    run = flight.runs[method]
    errors = [d for m in range(5) for d in distances(run.predicted[:, m], run.found[:, m])]
    cells = vibration_table(trials, shaken).rows[row]
    assert cells[2 + RUNS.index(method)] == pytest.approx(root_mean_square(errors))


def test_truth_of_table_5_3(flown):
    trials, _ = flown
    for trial in (0, 2, 3):
        found, predicted = [], []
        for flight in trials[trial].flights:
            run = flight.runs['as shipped']
            for marker in range(5):
                found += distances(run.found[:, marker], flight.places[:, marker])
                predicted += distances(run.predicted[:, marker], flight.places[:, marker])
        assert places_table(trials).rows[2 * trial + 1][4] == pytest.approx(root_mean_square(found))
        cells = predicted_table(trials).rows[trial]
        assert cells[1 + RUNS.index('as shipped')] == pytest.approx(root_mean_square(predicted))


def test_error_bars_of_appendix_c(flown):
    flight = flown[0][0].first
    means, deviations = mean_and_deviation(flight)
    run = flight.runs['acceleration_program']
    for marker in (0, 2, 4):
        errors = distances(run.predicted[3:, marker], run.found[3:, marker])
        assert means[marker] == pytest.approx(statistics.fmean(errors))
        assert deviations[marker] == pytest.approx(statistics.stdev(errors))


@pytest.mark.parametrize('condition', [1, 2, 3])
def test_table_5_4(condition):
    """A Fourier transform of the raw angles, without Welch's segments."""
    shake = Shake(VIBRATIONS[condition], 1.0, np.random.default_rng([9, condition]))
    roll = np.degrees([shake.angles(i / 500)[2] for i in range(50_000)])
    spectrum = np.abs(np.fft.rfft(roll * np.hanning(len(roll)))) * 4 / len(roll)
    strongest = int(spectrum.argmax())
    _, here = table_5_4([measure(condition, 9)]).rows
    assert here[2].value == pytest.approx(strongest / 100, abs=0.05)
    listed = known.cell('table_5_4', known.CONDITIONS[condition], 'Primary Frequency').value
    assert strongest / 100 == pytest.approx(listed, abs=0.011)
    assert here[3].value == pytest.approx(spectrum.max() / ROLL_DEG_PER_MAGNITUDE, rel=0.05)


def test_a_camera_at_rest_swings_with_no_frequency():
    _, here = table_5_4([measure(0, 9)]).rows
    assert here[2:] == (None, None, None)


def test_table_5_5():
    flown = [fly_markers(task) for task in roll_tasks(PLAN)]
    swings, errors = roll_tables(cells_of(flown), PLAN)
    for roll, condition in ((0, 0), (1, 2), (2, 3)):
        first = 2 * (4 * roll + condition)
        spread, wrong = [], []
        for flight in flown[first : first + 2]:
            assert math.isclose(flight.settings.roll_deg, known.ROLLS_DEG[roll])
            measured = [math.degrees(r) for r in flight.runs['as shipped'].roll]
            assert len(measured) == PLAN.measurements
            assert np.allclose(np.diff(flight.time), 1.0)
            spread.append(statistics.pvariance(measured))
            wrong += [m - math.degrees(t) for m, t in zip(measured, flight.roll, strict=True)]
        cell = swings.rows[4 * condition + 2][2 + roll]
        assert cell.value == pytest.approx(math.sqrt(statistics.fmean(spread)))
        text = errors.rows[2 * condition + 1][2 + roll]
        assert float(text.split()[0]) == pytest.approx(root_mean_square(wrong), abs=6e-5)


def test_executions_of_table_5_2():
    times = time_programs(trial_images(PLAN, 1), PLAN)
    frames, pixels = PLAN.trial_frames, 640 * 480
    assert times['No Estimation'].executions['Image Scanning'] == frames * pixels
    for program in known.ESTIMATIONS:
        executions = times[program].executions
        assert executions['Image Scanning'] == 3 * pixels
        assert executions['Scanning for Estimation'] == (frames - 3) * 5 * 21 * 21
        assert executions['Marker Definition'] == 3
    # The thesis's own counts, of 150 frames.
    assert known.cell('table_5_2', 'Image Scanning', 'No Estimation, executions').value == (
        150 * pixels
    )
    scanned = known.cell('table_5_2', 'Scanning for Estimation', 'Velocity Only, executions')
    assert scanned.value == 147 * 5 * 21 * 21


@pytest.fixture(scope='module')
def runway():
    tasks = runway_tasks(PLAN)[:2]
    names = ('low pass', 'low pass, gain steps, 10 Hz camera')
    return tasks, {name: fly_runway(task) for name, task in zip(names, tasks, strict=True)}


def test_figure_4_30_and_flags(runway):
    tasks, scenes = runway
    name = list(scenes)[1]
    results = process_again(tasks[1], THESIS_YAML)
    frames = len(results)
    counts = [
        sum(any(bool(line.flags & bit) for line in r.lines) for r in results) for bit in (1, 2, 4)
    ]
    row = next(r for r in flags_table(scenes).rows if r[:2] == (name, THESIS_YAML))
    assert row[2:5] == tuple(f'{count} / {frames}' for count in counts)
    cells = {r[0]: r[2] for r in figure_4_30(scenes[name]).rows}
    for flag, count in zip(('Rho', 'Theta', 'Main'), counts, strict=True):
        assert cells[f'{flag} flag, frames of 150'].value == pytest.approx(150 * count / frames)
    rhos = [r.lines[0].rho for r in results]
    thetas = [r.lines[0].theta for r in results]
    if max(thetas) - min(thetas) < math.pi / 2:
        assert cells['Rho 1, mean'] == pytest.approx(statistics.fmean(rhos))
        assert cells['Rho 1, standard deviation'].value == pytest.approx(statistics.stdev(rhos))
        assert cells['Theta 1, mean'] == pytest.approx(statistics.fmean(thetas))


def process_again(task, name):
    parameters = task.detectors[name]
    detector = (ApproachDetector if parameters.mode == 'approach' else RunwayDetector)(parameters)
    return [detector.process(f.image.bgr(), f.stamp_ns) for f in RunwayFlight(task.flight)]


def test_lines_found(runway):
    """By where a line crosses row 90, instead of by the distance of a point from it."""
    tasks, scenes = runway
    truths = [f.truth for f in RunwayFlight(tasks[0].flight)]
    for name, row in ((THESIS_YAML, 0), ('as shipped', 3), (APPROACH, 6)):
        hits, visible = 0, 0
        for result, truth in zip(process_again(tasks[0], name), truths, strict=True):
            edge = truth.lines[0]
            if not (edge.visible and min(edge.y1, edge.y2) <= 90 <= max(edge.y1, edge.y2)):
                continue
            visible += 1
            slope = (edge.x2 - edge.x1) / (edge.y2 - edge.y1)
            x = edge.x1 + slope * (90 - edge.y1)
            for line in result.lines:
                if not line.found or math.isnan(line.rho):
                    continue
                aside = abs(x * math.cos(line.theta) + 90 * math.sin(line.theta) - line.rho)
                turn = abs(math.degrees(math.remainder(line.theta - edge.theta, math.pi)))
                if aside <= 5.0 and turn <= 3.0:
                    hits += 1
                    break
        cell = found_table(scenes).rows[row][3]
        assert cell == pytest.approx(100 * hits / visible, abs=100 / visible)


def test_approach(runway):
    _, scenes = runway
    for row, flight in zip(approach_table(scenes).rows, scenes.values(), strict=True):
        run = flight.runs[APPROACH]
        judged = [i for i in range(25, len(run.right)) if run.right[i] is not None]
        assert row[1] == len(judged)
        if judged:
            assert row[2] == pytest.approx(100 * np.mean([run.right[i] for i in judged]))
            assert row[4] == pytest.approx(100 * np.mean([run.wrong[i] for i in judged]))

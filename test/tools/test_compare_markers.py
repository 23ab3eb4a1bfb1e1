"""The nets under the marker tracker: flights whose truth is right, scores, and two versions."""

import csv
import json
import math
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.marker_flights import (
    DISTORTION,
    HEIGHT,
    MATRIX,
    SCENES,
    WIDTH,
    MarkerFlight,
    Scene,
    draw,
    project,
    rotation_of,
)
from support.marker_scores import FlightScore, summary

ROOT = Path(__file__).resolve().parents[2]
TOOL = ROOT / 'tools' / 'compare_markers.py'


def test_projection_is_that_of_opencv():
    rng = np.random.default_rng(1)
    for _ in range(20):
        points = rng.uniform(-10.0, 10.0, (6, 3))
        rvec, translation = rng.normal(0.0, 1.0, 3), np.array((1.0, -2.0, rng.uniform(25, 60)))
        rotation = cv2.Rodrigues(rvec)[0]
        expected = cv2.projectPoints(points, rvec, translation, MATRIX, np.array(DISTORTION))[0]
        found = project(points, rotation, translation)
        assert np.abs(found - expected.reshape(-1, 2)).max() < 1e-8


def test_turns_are_about_the_three_axes_in_turn():
    axes = np.eye(3)
    for angles in np.random.default_rng(2).uniform(-2.0, 2.0, (10, 3)):
        about = [cv2.Rodrigues(angle * axis)[0] for angle, axis in zip(angles, axes, strict=True)]
        assert np.allclose(rotation_of(*angles), about[2] @ about[1] @ about[0], atol=1e-12)


def test_a_lamp_is_drawn_where_it_is():
    for x, y, radius in np.random.default_rng(3).uniform((30, 30, 2), (70, 70, 6), (20, 3)):
        image = np.full((100, 100), 60, np.uint8)
        draw(image, np.array((x, y)), radius)
        weights = image.astype(float) - 60
        rows, columns = np.mgrid[:100, :100]
        centre = (weights * columns).sum() / weights.sum(), (weights * rows).sum() / weights.sum()
        assert math.dist(centre, (x, y)) < 0.03
        assert (image > 178).sum() == pytest.approx(math.pi * radius**2, rel=0.35)


def test_a_lamp_beyond_the_border_is_cut():
    image = np.zeros((50, 50), np.uint8)
    draw(image, np.array((-1.0, 25.0)), 4.0)
    assert image[25, 0] == 255 and not image[:, 8:].any()
    draw(image, np.array((900.0, -900.0)), 4.0)
    assert not image[:, 8:].any()


def bright_places(image):
    count, _, _, centres = cv2.connectedComponentsWithStats((image > 178).astype(np.uint8))
    return centres[1:count]


@pytest.mark.parametrize('name', ['usual', 'three lights', 'eight lights', 'rig off by 0.5 %'])
def test_every_whole_marker_is_a_blob_at_its_place(name):
    for _, image, truth in list(MarkerFlight(SCENES[name], 5))[::20]:
        places = bright_places(image)
        for pixel in truth.pixels[truth.whole]:
            assert np.hypot(*(places - pixel).T).min() < 0.5


def test_what_is_not_whole_does_not_stand_alone():
    hidden = 0
    for name in ('lights out of view', 'crossing', 'impostors', 'everything at once'):
        flight = MarkerFlight(SCENES[name], 8)
        for frame in range(0, 180, 9):
            truth = flight.truth(frame)
            for marker in np.flatnonzero(~truth.whole):
                x, y = truth.pixels[marker]
                radius = flight.radii[frame, marker] + 4.0
                out = not (radius < x < WIDTH - radius and radius < y < HEIGHT - radius)
                others = [*np.delete(truth.pixels, marker, 0), *truth.others]
                near = min(math.dist((x, y), other) for other in others) < 35.0
                assert out or near or flight.dark[frame, marker]
                hidden += 1
    assert hidden > 20


def test_an_impostor_shines_in_the_place_of_a_dark_marker():
    met = 0
    for seed in range(6):
        flight = MarkerFlight(Scene(impostors=4), seed)
        images = {round(stamp * 30e-9): image for stamp, image, _ in flight}
        for other in flight.others:
            away = np.hypot(*(other.places - flight.pixels[:, other.marker]).T)
            there = np.flatnonzero((away < 4.0) & flight.dark[:, other.marker])
            assert len(there), 'it never was in the place'
            met += 1
            x, y = np.round(other.places[there[0]]).astype(int)
            if 0 <= x < WIDTH and 0 <= y < HEIGHT:
                assert images[there[0]][y, x] == 255
    assert met == 24


def test_frames_are_dropped_alone_and_in_a_row():
    stamps = [stamp for stamp, _, _ in MarkerFlight(Scene(dropped=0.3), 4)]
    steps = np.round(np.diff(stamps) * 30e-9).astype(int)
    assert len(stamps) == pytest.approx(0.7 * 180, abs=12)
    assert steps.min() == 1 and steps.max() > 3 and (steps == 2).any()


def test_all_lights_go_out_and_come_back():
    for seed in range(4):
        dark = MarkerFlight(Scene(blind=2), seed).dark.all(axis=1)
        assert dark.sum() >= 18 and not dark[0] and not dark[:20].any()


def test_lights_leave_the_view():
    gone = 0
    for seed in range(4):
        pixels = MarkerFlight(SCENES['lights out of view'], seed).pixels
        gone += ((pixels < 0) | (pixels >= (WIDTH, HEIGHT))).any(axis=2).mean()
    assert gone / 4 > 0.03


def test_rigs_and_calibrations_are_off_by_what_they_should():
    off = [MarkerFlight(Scene(rig_error=0.005, frames=2), seed) for seed in range(60)]
    shares = [np.square(flight.body - flight.rig).mean() / flight.size**2 for flight in off]
    assert math.sqrt(np.mean(shares)) == pytest.approx(0.005, rel=0.1)
    wrong = {
        round(float(MarkerFlight(Scene(focal_error=0.15, frames=2), s).matrix[0, 0]))
        for s in range(9)
    }
    assert wrong == {round(612 * 1.15), round(612 * 0.85)}
    assert MarkerFlight(Scene(focal_error=None, frames=2), 0).matrix is None
    assert (MarkerFlight(Scene(frames=2), 0).matrix == MATRIX).all()


def test_a_flight_is_the_same_each_time_and_another_with_another_seed():
    first, again, other = (list(MarkerFlight(SCENES['everything at once'], s)) for s in (1, 1, 2))
    assert all((a[1] == b[1]).all() for a, b in zip(first, again, strict=True))
    assert (first[50][2].pixels != other[50][2].pixels).all()


THREE = np.array([(10.0, 10.0), (90.0, 10.0), (50.0, 70.0)])
ALL = np.ones(3, bool)


def scored(*frames):
    """Each frame: names (n,), whole (n,) and how far the first one is off."""
    score = FlightScore()
    for named, whole, off in frames:
        places = THREE + np.array([(off, 0.0), (0.0, 0.0), (0.0, 0.0)])
        score.add(np.array(named, bool), places, THREE, np.array(whole, bool), True, 1.0)
    return score.figures()


def test_wrong_names_are_counted_in_runs():
    off = [(ALL, ALL, away) for away in (0, 5, 6, 3, 9, 0, 7)]
    figures = scored(*off)
    assert (figures['wrong'], figures['longest_wrong']) == (4, 2)


def test_a_name_that_is_not_told_is_missed_but_not_before_all_could_be_named():
    none, two = np.zeros(3), np.array((1, 1, 0))
    figures = scored((none, two, 0), (none, ALL, 0), (none, ALL, 0), (ALL, ALL, 0), (two, two, 0))
    assert (figures['whole'], figures['missed'], figures['start']) == (11, 6, 2)


def test_a_wait_ends_with_the_last_name_and_starts_after_the_start():
    two = np.array((1, 1, 0))
    waiting = [(two, ALL, 0)] * 5
    assert scored(*waiting)['waits'] == []
    assert scored((ALL, ALL, 0), *waiting, (ALL, ALL, 0), (two, ALL, 0))['waits'] == [5]
    assert scored((ALL, ALL, 0), *waiting)['waits'] == [5]


def test_recovery_lasts_from_the_return_to_the_name():
    two = np.array((1, 1, 0))
    gone = [(two, two, 0)] * 4
    back = [(two, ALL, 0)] * 6
    assert scored((ALL, ALL, 0), *gone, *back, (ALL, ALL, 0))['recoveries'] == [6]
    assert scored((ALL, ALL, 0), *gone, (ALL, ALL, 0))['recoveries'] == [0]
    assert scored((ALL, ALL, 0), *gone, *back, *gone)['recoveries'] == [6]
    assert scored((ALL, ALL, 0), *gone, *back)['recoveries'] == [6]


def test_a_pose_is_held_against_its_covariance():
    score = FlightScore()
    true = rotation_of(0.3, -0.2, 0.1), np.array((0.0, 3.0, 40.0))
    turn = cv2.Rodrigues(np.array((0.0, math.radians(2.0), 0.0)))[0]
    deviation = np.array((0.5, 0.5, 0.5, 0.02, 0.02, 0.02))
    score.add_pose((turn @ true[0], true[1] + (0, 0, 1.0), np.diag(deviation**2)), true)
    figures = score.figures()
    assert figures['moved'] == pytest.approx(1.0 / math.hypot(3, 40))
    assert figures['turned'] == pytest.approx(2.0)
    assert figures['nees'] == pytest.approx((1.0 / 0.5) ** 2 + (math.radians(2.0) / 0.02) ** 2)


def test_a_roll_counts_within_a_degree():
    score = FlightScore()
    left, right = np.array((0.0, 0.0)), np.array((100.0, 100.0))
    score.add_roll(math.pi / 4, left, right)
    assert score.figures()['rolls'] == [0, 0]
    score.add(ALL, THREE, THREE, ALL, True, 1.0)
    for degrees in (45.5, 46.5, math.nan):
        score.add_roll(math.radians(degrees), left, right)
    assert score.figures()['rolls'] == [3, 1]


def test_groups_are_summed():
    one = scored(*[(ALL, ALL, away) for away in (0, 5, 6)])
    two = scored(*[(ALL, ALL, away) for away in (9, 0, 0)])
    row = summary([one, two])
    assert (row['flights'], row['frames'], row['wrong'], row['longest_wrong']) == (2, 6, 3, 2)
    assert row['missed_percent'] == 0.0 and row['pose_percent'] == 0.0


def compare(*arguments):
    """Lines of the table for a few flights of twenty frames."""
    group = ['--flights', '1', '--only', 'package: eight']
    run = subprocess.run(
        [sys.executable, TOOL, *group, *arguments], check=True, text=True, capture_output=True
    )
    return run.stdout.splitlines()


def test_two_versions_side_by_side(tmp_path):
    kept, flights = tmp_path / 'kept.json', tmp_path / 'flights.csv'
    shown = compare('--seeds', '77', '78', '--against', ROOT, '--json', kept, '--csv', flights)
    assert [line.split(' | ')[2] for line in shown[2:]] == ['against', 'this'] * 2

    def without_times(row):
        return {name: value for name, value in row.items() if not name.endswith('_ms')}

    told = json.loads(kept.read_text())
    rows = [told[name]['groups']['package: eight markers at any roll'] for name in told]
    assert list(told) == ['against', 'this']
    assert without_times(rows[0]) == without_times(rows[1])
    assert rows[0]['frames'] == 20 and rows[0]['usual_ms'] > 0.0
    with flights.open() as file:
        assert [(row['version'], row['seed']) for row in csv.DictReader(file)] == [
            ('against', '77'),
            ('this', '77'),
        ]
    again = compare('--seeds', '78', '79', '--against', kept, '--kept', 'against')
    assert [line.split(' | ')[2] for line in again[2:]] == ['against (kept)', 'this', 'this']


def test_kept_figures_are_of_both_halves():
    kept = json.loads((ROOT / 'test/data/marker_flights.json').read_text())
    seeds = [one['seeds'] for one in kept.values()]
    assert any(first < 30000 for first, _ in seeds) and any(first >= 30000 for first, _ in seeds)
    for one in kept.values():
        # They were flown before there were flights with lamps, and before bright ground.
        assert set(SCENES) - {'lamps on the body', 'bright ground'} < set(one['groups'])
        assert one['groups']['all']['flights'] >= 300


def test_every_mechanism_can_be_switched_off():
    code = 'import marker_mechanisms as m\nfor name in m.WITHOUT: m.switch_off(name)'
    environment = {'PYTHONPATH': f'{ROOT}:{TOOL.parent}', 'PATH': ''}
    subprocess.run([sys.executable, '-c', code], check=True, env=environment)

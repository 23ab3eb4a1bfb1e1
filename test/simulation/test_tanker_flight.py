import itertools
import math

import numpy as np
import pytest
from support.image_measuring import weighted_centroid

from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.simulation.flight import motion_blur
from mvuav_ros.simulation.settings import BACKGROUNDS, TANKER_MOTIONS, TRIALS, TankerSettings
from mvuav_ros.simulation.tanker_flight import TankerFlight
from mvuav_ros.vision.markers.marker_results import MarkerState
from mvuav_ros.vision.markers.tracker import MarkerTracker


def flight(**values) -> TankerFlight:
    return TankerFlight(TankerSettings(**values))


def test_the_same_settings_give_the_same_frames_and_another_seed_others():
    values = {
        'frames': 6,
        'motion': 'erratic',
        'shake': 2,
        'hot_pixels': 3,
        'glares': 2,
        'gain_steps': 0.1,
        'drop_probability': 0.3,
        'fps': 5.0,
    }
    first = flight(**values, seed=5)
    frames = list(first)
    for again in (list(first), list(flight(**values, seed=5))):
        assert [f.stamp_ns for f in frames] == [f.stamp_ns for f in again]
        assert all(
            np.array_equal(a.image.pixels, b.image.pixels)
            for a, b in zip(frames, again, strict=True)
        )
        assert [f.truth.markers for f in frames] == [f.truth.markers for f in again]
    other = flight(**values, seed=6)
    assert other.truth(0).markers != first.truth(0).markers
    assert not np.array_equal(other.frame(0).image.pixels, first.frame(0).image.pixels)


@pytest.mark.parametrize(
    'values',
    [
        {},
        {'encoding': 'bgr8', 'motion': 'translation'},
        # During an exposure a vibration of 66 Hz bends the path: its mean is not its middle.
        {'motion': 'erratic', 'shake': 3, 'exposure': 0.0},
        {'motion': 'roll_360', 'distortion': '-0.2, 0.05, 0.001, -0.001'},
        {'motion': 'docking', 'detail': 0.2},
        {'background': 'plain', 'gain_steps': 0.2},
    ],
)
def test_lights_lie_where_the_truth_says(values):
    sim = flight(noise=0.0, **values)
    errors, rolls = [], []
    for index in range(0, 300, 17):
        frame = sim.frame(index)
        gray = frame.image.gray()
        found = {m.name: weighted_centroid(gray, m.x, m.y) for m in frame.truth.markers if m.whole}
        assert len(found) == 5
        errors += [np.subtract(found[m.name], (m.x, m.y)) for m in frame.truth.markers]
        dx, dy = np.subtract(found['right_wing'], found['left_wing'])
        rolls.append(math.remainder(math.atan2(dy, dx) - frame.truth.roll, 2 * math.pi))
    assert np.sqrt(np.mean(np.square(errors))) < 0.006
    assert np.abs(errors).max() < 0.02
    assert np.degrees(np.abs(rolls)).max() < 0.005


def light(truth, name):
    (found,) = (marker for marker in truth.markers if marker.name == name)
    return found


def test_roll_is_positive_with_the_right_wing_down():
    truth = flight(motion='still', roll_deg=20.0).truth(0)
    assert math.degrees(truth.roll) == pytest.approx(20.0, abs=0.2)
    assert light(truth, 'right_wing').y > light(truth, 'left_wing').y
    assert light(truth, 'right_wing').x > light(truth, 'left_wing').x
    assert light(truth, 'rudder').y < light(truth, 'left_stabilizer').y


def test_velocities_are_those_of_the_places():
    sim = flight(motion='roll_translation', shake=1, fps=1000.0, frames=500)
    step = 1e-5
    before, now, after = (sim.truth_at(0.4 + d) for d in (-step, 0.0, step))
    for a, marker, b in zip(before.markers, now.markers, after.markers, strict=True):
        assert marker.vx == pytest.approx((b.x - a.x) / (2 * step), abs=0.05)
        assert marker.vy == pytest.approx((b.y - a.y) / (2 * step), abs=0.05)
    assert max(abs(m.vx) for m in now.markers) > 10.0


@pytest.mark.parametrize('trial', TRIALS)
def test_trials_keep_the_markers_in_view_and_apart(trial):
    sim = flight(motion=trial, frames=600)
    for index in range(0, 600, 3):
        markers = sim.truth(index).markers
        assert all(m.whole for m in markers)
        for a, b in itertools.combinations(markers, 2):
            assert math.hypot(a.x - b.x, a.y - b.y) > 20.0


@pytest.mark.parametrize(
    'trial',
    [
        *TRIALS[:1],
        *(pytest.param(trial, marks=pytest.mark.long) for trial in TRIALS[1:-1]),
        TRIALS[-1],
    ],
)
def test_trials_are_tracked_without_loss(trial):
    pipeline = MarkerTracker()
    for frame in flight(motion=trial, frames=300):
        result = pipeline.process(frame.image, frame.stamp_ns)
        assert all(m.state is MarkerState.DETECTED for m in result.markers)
        for found, true in zip(result.markers, frame.truth.markers, strict=True):
            assert found.label.name.lower() == true.name
            assert math.hypot(found.x - true.x, found.y - true.y) < 0.6
        assert result.roll == pytest.approx(frame.truth.roll, abs=math.radians(0.2))


@pytest.mark.parametrize('view', ['lab', 'receiver'])
@pytest.mark.parametrize('motion', TANKER_MOTIONS)
def test_every_motion_and_view_runs(motion, view):
    sim = flight(motion=motion, view=view, frames=60, fps=6.0, glares=1)
    for index in (0, 59):
        frame = sim.frame(index)
        lit = [m for m in frame.truth.markers if m.whole]
        assert all(frame.image.gray()[round(m.y), round(m.x)] > 240 for m in lit)
    assert sum(m.visible for m in sim.truth(0).markers) == 5


@pytest.mark.parametrize('encoding', ['mono8', 'bgr8'])
@pytest.mark.parametrize('background', BACKGROUNDS)
def test_no_background_is_bright_enough_for_a_marker(background, encoding):
    sim = flight(background=background, encoding=encoding, frames=2, failures='all@0-9', shake=1)
    gray = sim.frame(1).image.gray()
    assert sim.frame(1).image.encoding == encoding
    assert gray.shape == (480, 640)
    assert 30 < np.median(gray) < 150
    assert gray.max() < 178
    assert not any(m.visible for m in sim.truth(1).markers)


def test_a_failed_light_is_dark_and_not_visible():
    sim = flight(motion='still', failures='rudder@1-2', frames=90)
    for index, lit in ((29, True), (30, False), (59, False), (60, True)):
        frame = sim.frame(index)
        rudder = light(frame.truth, 'rudder')
        assert rudder.visible is lit
        bright = frame.image.gray()[round(rudder.y), round(rudder.x)] > 178
        assert bright == lit


@pytest.mark.parametrize('name', ['left_wing', 'rudder', 'right_stabilizer'])
@pytest.mark.parametrize('view', ['lab', 'receiver'])
def test_the_boom_hides_its_light_and_the_truth_knows(name, view):
    sim = flight(motion='roll', view=view, occlusions=f'{name}@2-3', frames=180)
    for index in range(0, 180, 6):
        frame = sim.frame(index)
        gray = frame.image.gray()
        for marker in frame.truth.markers:
            value = gray[round(marker.y), round(marker.x)]
            if marker.whole:
                assert value > 240
            elif not marker.visible:
                assert value < 178
        if 60 <= index < 90:
            assert not light(frame.truth, name).visible
        if index < 15 or index > 140:
            assert all(m.whole for m in frame.truth.markers)


def test_a_marker_that_leaves_the_frame_is_not_visible():
    sim = flight(motion='docking', fov_deg=40.0)
    truth = sim.truth(299)
    wings = [light(truth, 'left_wing'), light(truth, 'right_wing')]
    assert any(not 0 <= m.x < 640 for m in wings)
    for marker in truth.markers:
        inside = -0.5 <= marker.x < 639.5 and -0.5 <= marker.y < 479.5
        assert marker.visible is inside


def test_docking_closes_from_60_to_10_metres_with_all_markers_in_view():
    sim = flight(motion='docking')
    assert sim.truth(0).distance == pytest.approx(60.0, abs=2.0)
    assert sim.truth(299).distance == pytest.approx(10.0, abs=0.6)
    assert all(m.whole for i in range(0, 300, 5) for m in sim.truth(i).markers)


def test_roll_360_turns_right_round_and_crossing_passes_at_five_pixels():
    turn = flight(motion='roll_360', frames=300)
    rolls = np.unwrap([turn.truth(i).roll for i in range(0, 300, 5)])
    assert rolls[-1] - rolls[0] > math.radians(345)
    crossing = flight(motion='crossing', frames=360)
    closest = min(
        math.hypot(a.x - b.x, a.y - b.y)
        for i in range(360)
        for a, b in itertools.combinations(crossing.truth(i).markers, 2)
    )
    assert 4.0 < closest < 6.0


def test_hot_pixels_and_glares_are_there_and_stay():
    plain = flight(motion='still', noise=0.0, frames=60)
    spoilt = flight(motion='still', noise=0.0, frames=60, hot_pixels=5, glares=3)
    for index in (0, 50):
        before, after = (s.frame(index).image.pixels for s in (plain, spoilt))
        added = (after > 178) & (before <= 178)
        assert np.count_nonzero(added) > 5 + 3 * 30
    places = [np.argwhere(spoilt.frame(i).image.pixels == 255) for i in (0, 50)]
    common = set(map(tuple, places[0])) & set(map(tuple, places[1]))
    assert len(common) >= 5


def test_shake_grows_with_its_setting():
    spreads = []
    for level in range(4):
        sim = flight(motion='still', shake=level, frames=300)
        x = [light(sim.truth(i), 'rudder').x for i in range(0, 300, 3)]
        spreads.append(np.std(x))
    assert spreads[0] < 1e-9
    assert 0.2 < spreads[1] < spreads[2] < spreads[3] < 3.0


def test_noise_has_the_sigma_asked_for():
    quiet, noisy = (
        flight(motion='still', background='plain', airframe=False, frames=2, noise=s)
        for s in (0.0, 3.0)
    )
    difference = noisy.frame(1).image.pixels.astype(int) - quiet.frame(1).image.pixels
    assert difference[:50].std() == pytest.approx(3.0, abs=0.1)
    assert difference[:50].mean() == pytest.approx(0.0, abs=0.1)
    assert not np.array_equal(noisy.frame(0).image.pixels, noisy.frame(1).image.pixels)


def test_dropped_frames_leave_gaps_in_the_stamps():
    sim = flight(frames=2000, drop_probability=0.3, motion='still')
    assert len(sim) == pytest.approx(1400, abs=80)
    assert sim.indices != list(range(len(sim)))
    stamps = [sim.stamp_ns(i) for i in sim.indices]
    steps = np.diff(stamps) * 30e-9
    assert np.allclose(steps, np.rint(steps), atol=1e-6)
    assert steps.max() > 2.5


def test_a_slow_camera_repeats_its_image():
    sim = flight(motion='roll', camera_rate=10.0, frames=9)
    frames = list(sim)
    assert len({f.stamp_ns for f in frames}) == 9
    same = [np.array_equal(a.image.pixels, b.image.pixels) for a, b in itertools.pairwise(frames)]
    assert same == [True, True, False, True, True, False, True, True]
    assert sim.seen_at(5) == pytest.approx(0.1)


def test_a_body_can_be_flown_past(tmp_path):
    path = tmp_path / 'pod.yaml'
    path.write_text(
        '{markers: {a: [0, 0.4, 0], b: [0, -0.4, 0], c: [-1, 0, 0.3]}, dock: [2, 0, 0]}'
    )
    values = {'start_distance': 10.0, 'end_distance': 1.0, 'layout': str(path)}
    frame = flight(motion='docking', frames=60, **values).frame(59)
    assert all(math.isnan(marker.x) and not marker.visible for marker in frame.truth.markers)
    # Right before that the lights cross the image in no time.
    image = np.zeros((48, 64), np.uint8)
    image[:, 32] = 255
    np.testing.assert_array_equal(motion_blur(image, 900.0, 0.0), motion_blur(image, 64.0, 0.0))


@pytest.mark.parametrize(
    ('values', 'name'),
    [
        ({'frames': 0}, 'frames'),
        ({'fps': math.nan}, 'fps'),
        ({'motion': 'loop'}, 'motion'),
        ({'shake': 4}, 'shake'),
        ({'noise': -1.0}, 'noise'),
        ({'width': 640.5}, 'width'),
        ({'fov_deg': 1.0}, 'fov_deg'),
        ({'end_distance': 70.0}, 'end_distance'),
        ({'failures': 'rudder'}, 'failures'),
        ({'failures': 'rudder@3-2'}, 'failures'),
        ({'occlusions': 'all@1-2'}, 'occlusions'),
        ({'occlusions': 'rudder@1-3, left_wing@2-4'}, 'occlusions'),
        ({'distortion': '1 2 3'}, 'distortion'),
        ({'distortion': '-3 0 0 0'}, 'distortion'),
        ({'distortion': '1e308 1e308 0 0 1e308'}, 'distortion'),
        ({'failures': 'nose@1-2'}, 'failures'),
        ({'layout': '/no/such/file.yaml'}, 'layout'),
    ],
)
def test_settings_that_cannot_be_are_refused(values, name):
    with pytest.raises(ParameterError) as refused:
        flight(**values)
    assert refused.value.name == name

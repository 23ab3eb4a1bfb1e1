"""Where the thesis's tracking program stops and ours goes on."""

import math

import numpy as np
import pytest
from support.marker_scenes import draw, image, tanker_at

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.marker_results import Label, MarkerState, Window
from mvuav_ros.vision.markers.thesis_tracker import Motion
from mvuav_ros.vision.markers.tracker import MarkerTracker

LOST, DETECTED, PREDICTED = MarkerState.LOST, MarkerState.DETECTED, MarkerState.PREDICTED
STEP_NS = 100_000_000


class Flight:
    """A pipeline fed at 10 frames per second."""

    def __init__(self, **parameters):
        self.pipeline = MarkerTracker(MarkerTrackerParameters.from_mapping(parameters))
        self.stamp_ns = 0

    def see(self, places, **keywords):
        self.stamp_ns += STEP_NS
        return self.pipeline.process(image(places, **keywords), self.stamp_ns)


def states(result):
    return [marker.state for marker in result.markers]


def test_three_whole_frames_then_windows():
    flight = Flight(prediction='velocity')
    for _ in range(3):
        assert flight.see(tanker_at()).windows == ()
    result = flight.see(tanker_at())
    assert len(result.windows) == 5
    assert all(w.x1 - w.x0 == w.y1 - w.y0 == 20 for w in result.windows)


def test_velocity_and_acceleration_of_a_marker():
    flight = Flight(prediction='acceleration')
    x = [200.0, 203.0, 208.0]
    for position in x:
        result = flight.see(tanker_at(position, 240))
    marker = result.markers[Label.RUDDER]
    assert marker.vx == pytest.approx(50.0, abs=0.2)
    assert marker.ax == pytest.approx(200.0, abs=2.0)
    assert marker.vy == pytest.approx(0.0, abs=0.2)


def test_a_hidden_marker_is_predicted_along_its_way_then_lost():
    flight = Flight(lost_timeout=0.35, prediction='velocity')
    for step in range(4):
        flight.see(tanker_at(200 + 4 * step, 240))
    seen = []
    for step in range(4, 9):
        result = flight.see(np.delete(tanker_at(200 + 4 * step, 240), Label.RUDDER, axis=0))
        seen.append(result.markers[Label.RUDDER])
        others = [m.state for m in result.markers if m.label is not Label.RUDDER]
        assert others == [DETECTED] * 4
    assert [m.state for m in seen] == [PREDICTED] * 3 + [LOST] * 2
    for step, marker in zip(range(4, 7), seen, strict=False):
        assert marker.x == pytest.approx(200 + 4 * step, abs=0.3)
        assert marker.y == pytest.approx(180, abs=0.3)
        assert math.isnan(marker.area)
    assert all(math.isnan(value) for value in seen[3][2:])
    assert '1 lost' in result.status


def test_a_marker_that_returns_in_time_is_detected_again():
    flight = Flight()
    for _ in range(4):
        flight.see(tanker_at())
    assert states(flight.see(np.delete(tanker_at(), 0, axis=0))) == [PREDICTED, *[DETECTED] * 4]
    assert states(flight.see(tanker_at())) == [DETECTED] * 5


def test_after_a_loss_the_whole_frame_is_searched_and_tracking_starts_again():
    flight = Flight(lost_timeout=0.15)
    for _ in range(4):
        flight.see(tanker_at(150, 200))
    for _ in range(3):
        result = flight.see([])
    assert states(result) == [LOST] * 5
    assert math.isnan(result.roll)
    found = flight.see(tanker_at(400, 300))
    assert states(found) == [DETECTED] * 5
    assert found.markers[Label.RUDDER].x == pytest.approx(400, abs=0.1)
    flight.see(tanker_at(400, 300))
    flight.see(tanker_at(400, 300))
    assert len(flight.see(tanker_at(400, 300)).windows) == 5


def test_roll_needs_both_wings():
    flight = Flight(lost_timeout=0.0)
    for _ in range(3):
        assert flight.see(tanker_at(roll_deg=20)).roll == pytest.approx(math.radians(20), abs=2e-3)
    without_rudder = flight.see(np.delete(tanker_at(roll_deg=20), Label.RUDDER, axis=0))
    assert without_rudder.roll == pytest.approx(math.radians(20), abs=2e-3)
    flight.see(tanker_at(roll_deg=20))
    without_wing = flight.see(np.delete(tanker_at(roll_deg=20), Label.RIGHT_WING, axis=0))
    assert math.isnan(without_wing.roll)


def test_a_window_that_leaves_the_image_is_clipped():
    flight = Flight(prediction='velocity')
    for step in range(12):
        result = flight.see(tanker_at(160 - 3 * step, 240))
    left_window = result.windows[Label.LEFT_WING]
    assert left_window.x0 == 0
    assert left_window.x1 < 20
    assert result.markers[Label.RIGHT_WING].state is DETECTED
    for step in range(12, 40):
        result = flight.see(tanker_at(160 - 3 * step, 240))
    assert result.markers[Label.LEFT_WING].state is LOST
    assert result.markers[Label.RIGHT_WING].state is DETECTED


def test_names_that_go_on_with_one_light_are_said_to():
    flight = Flight(prediction='velocity')
    places = tanker_at()
    towards = (places[Label.LEFT_STABILIZER] - places[Label.RUDDER]) / 10
    for _ in range(11):
        flight.see(places)
        places[Label.RUDDER] += towards
    for _ in range(5):
        result = flight.see(np.delete(tanker_at(), Label.RUDDER, axis=0))
    assert states(result) == [DETECTED] * 5
    assert result.status == "1 of the names are on another one's light"


def test_windows_are_rounded_and_clipped():
    assert Window.around(100.5, 99.49, 10, (640, 480)) == (91, 111, 89, 109)
    assert Window.around(3, 478, 10, (640, 480)) == (0, 13, 468, 479)
    assert Window.around(637, 2, 10, (640, 480)) == (627, 639, 0, 12)
    outside = Window.around(-50, 20, 10, (640, 480))
    assert outside.x1 < outside.x0


@pytest.mark.parametrize('mode', ['detect', 'track'])
def test_fewer_than_five_clusters_are_not_named(mode):
    flight = Flight(mode=mode)
    result = flight.see(tanker_at()[:4])
    assert states(result) == [LOST] * 5
    assert '4 of 5' in result.status


def test_five_markers_among_hot_pixels():
    image = draw(tanker_at())
    image[100:400:37, 5] = 255
    result = Flight(mode='detect').pipeline.process(Image(image, 'mono8'), 0)
    assert [m.x for m in result.markers] == pytest.approx(tanker_at()[:, 0], abs=0.1)


def test_clusters_too_much_alike_are_not_named():
    places = [*tanker_at(), (320, 400)]
    assert states(Flight(mode='detect').see(places)) == [LOST] * 5


def test_area_limits():
    places = tanker_at()
    image = draw(places)
    image[50, 50] = 255
    any_size = MarkerTracker(MarkerTrackerParameters(mode='detect_any'))
    assert len(any_size.process(Image(image, 'mono8'), 0).markers) == 6
    larger = MarkerTracker(MarkerTrackerParameters(mode='detect_any', min_area=2))
    assert len(larger.process(Image(image, 'mono8'), 0).markers) == 5
    smaller = MarkerTracker(MarkerTrackerParameters(mode='detect_any', max_area=10))
    assert len(smaller.process(Image(image, 'mono8'), 0).markers) == 1


@pytest.mark.parametrize('mode', ['detect', 'detect_any', 'track'])
@pytest.mark.parametrize(
    'image',
    [
        np.full((1080, 1920), 255, np.uint8),
        np.where(np.random.default_rng(0).random((1080, 1920)) < 0.02, 255, 0).astype(np.uint8),
    ],
    ids=['white', 'salt and pepper'],
)
def test_frames_without_markers_give_a_clear_status(mode, image):
    result = Flight(mode=mode).pipeline.process(Image(image, 'mono8'), 0)
    assert 'threshold' in result.status
    assert all(marker.state is LOST for marker in result.markers)


@pytest.mark.parametrize('mode', ['detect', 'detect_any', 'track'])
@pytest.mark.parametrize('shape', [(1, 1), (1, 400), (400, 1), (21, 21)])
@pytest.mark.parametrize('value', [0, 255])
def test_tiny_frames_give_a_result(mode, shape, value):
    flight = Flight(mode=mode)
    image = Image(np.full(shape, value, np.uint8), 'mono8')
    for stamp_ns in range(5):
        result = flight.pipeline.process(image, stamp_ns)
    if mode != 'detect_any':
        assert len(result.markers) == 5
        assert math.isnan(result.roll)
    else:
        assert bool(result.markers) == bool(value)


@pytest.mark.parametrize(
    ('parameters', 'count'),
    [({}, 5), ({'prediction': 'velocity'}, 5), ({'mode': 'track_any'}, 0)],
)
def test_a_smaller_frame_while_tracking(parameters, count):
    flight = Flight(**parameters)
    for _ in range(4):
        flight.see(tanker_at())
    result = flight.see([], size=(64, 48))
    # Nothing that was known holds on a frame of another size.
    assert states(result) == [LOST] * count


def test_stamps_must_grow():
    flight = Flight()
    flight.see(tanker_at())
    with pytest.raises(ValueError, match='not later'):
        flight.pipeline.process(image(tanker_at()), STEP_NS)


def test_parameters_change_between_frames():
    flight = Flight()
    for _ in range(4):
        flight.see(tanker_at())
    flight.pipeline.configure(flight.pipeline.parameters.changed({'search_radius': 15}))
    assert flight.see(tanker_at()).windows[0].x1 - flight.see(tanker_at()).windows[0].x0 == 30
    flight.pipeline.configure(flight.pipeline.parameters.changed({'mode': 'detect_any'}))
    assert [m.label for m in flight.see(tanker_at()).markers] == [Label.UNLABELLED] * 5


def test_time_steps_come_from_the_stamps():
    """A dropped frame doubles the step, and the prediction with it."""
    motion = Motion()
    for time, x in ((0.0, 0.0), (0.1, 1.0), (0.3, 3.0)):
        motion.add(time, x, 0.0)
    assert motion.velocity[0] == pytest.approx(10.0)
    assert motion.acceleration[0] == pytest.approx(0.0, abs=1e-9)
    assert motion.predict(0.6, 'acceleration')[0] == pytest.approx(6.0)


def test_predictions():
    motion = Motion()
    motion.add(0.0, 0.0, 0.0)
    assert motion.predict(0.1, 'acceleration') == (0.0, 0.0)
    motion.add(0.1, 1.0, 0.0)
    assert motion.predict(0.2, 'acceleration')[0] == pytest.approx(2.0)
    motion.add(0.2, 3.0, 0.0)
    assert motion.predict(0.3, 'none')[0] == 3.0
    assert motion.predict(0.3, 'velocity')[0] == pytest.approx(5.0)
    assert motion.predict(0.3, 'acceleration')[0] == pytest.approx(5.5)
    assert motion.predict(0.3, 'acceleration_program')[0] == pytest.approx(4.75)
    motion.unseen = 2
    assert motion.predict(0.5, 'acceleration')[0] == pytest.approx(9.0)

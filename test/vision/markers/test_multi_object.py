"""Unlabelled lights under persistent numbers."""

import numpy as np
import pytest
from support.marker_scenes import draw

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.marker_results import Label, MarkerState
from mvuav_ros.vision.markers.tracker import MarkerTracker

DETECTED, PREDICTED = MarkerState.DETECTED, MarkerState.PREDICTED
STEP_NS = 33_000_000


class Lights:
    def __init__(self, **parameters):
        self.pipeline = MarkerTracker(MarkerTrackerParameters(mode='track_any', **parameters))
        self.stamp_ns = 0

    def see(self, places, step_ns=STEP_NS):
        self.stamp_ns += step_ns
        return self.pipeline.process(Image(draw(places), 'mono8'), self.stamp_ns)


def places_by_id(result):
    return {i: (m.x, m.y) for i, m in zip(result.ids, result.markers, strict=True)}


def test_any_number_of_lights_keep_their_numbers():
    rng = np.random.default_rng(1)
    start = np.array([(80 + 110 * (i % 5), 80 + 110 * (i // 5)) for i in range(15)], float)
    velocity = rng.uniform(-1.0, 1.0, start.shape)
    lights = Lights()
    for step in range(40):
        places = start + velocity * step
        result = lights.see(places)
        assert all(m.label == Label.UNLABELLED for m in result.markers)
        assert sorted(result.ids) == list(range(1, 16))
        found = places_by_id(result)
        if step == 0:
            order = [
                min(found, key=lambda i, p=place: np.hypot(*np.subtract(found[i], p)))
                for place in places
            ]
        for number, place in zip(order, places, strict=True):
            assert np.hypot(*np.subtract(found[number], place)) < 0.5


def test_lights_come_and_go():
    lights = Lights(lost_timeout=0.2)
    dark = 'no light in view; no pixel is above the threshold; the brightest is 0.16'
    assert lights.see([]).status == dark
    assert lights.see([(100, 100), (300, 300)]).ids == (1, 2)
    for step in range(5):
        result = lights.see([(100 + step, 100)])
        assert [m.state for m in result.markers] == [DETECTED, PREDICTED]
        assert result.status == '1 detected, 1 predicted'
    for step in range(5, 9):
        result = lights.see([(100 + step, 100)])
    assert result.ids == (1,)
    result = lights.see([(109, 100), (300, 300)])
    assert result.ids == (1, 3)


def test_a_light_that_returns_in_time_keeps_its_number():
    lights = Lights()
    for step in range(30):
        places = [(100 + 3 * step, 100), (500, 300 + step)]
        result = lights.see(places[1:] if 10 <= step < 18 else places)
    assert result.ids == (1, 2)
    assert places_by_id(result)[1] == pytest.approx((187, 100), abs=0.2)


def test_lights_that_pass_each_other():
    lights = Lights()
    for step in range(60):
        result = lights.see([(100 + 4 * step, 200), (336 - 4 * step, 212)])
    assert result.ids == (1, 2)
    assert places_by_id(result)[1] == pytest.approx((336, 200), abs=0.3)


def test_a_push_to_the_camera_moves_all_lights_at_once():
    start = np.array([(100, 100), (160, 110), (210, 90), (150, 180)], float)
    lights = Lights()
    for step in range(30):
        places = start + (55.0 if step >= 15 else 0.0)
        result = lights.see(places)
        assert result.ids == (1, 2, 3, 4), step
        found = np.array([places_by_id(result)[number] for number in (1, 2, 3, 4)])
        if step == 0:
            first = found
    np.testing.assert_allclose(found, first + 55.0, atol=0.2)


def test_dropped_frames():
    rng = np.random.default_rng(5)
    lights = Lights()
    gap = 0
    for step in range(100):
        gap += STEP_NS
        if step > 3 and rng.random() < 0.3:
            continue
        angle = 2 * np.pi * step / 100
        places = [
            (320 + 150 * np.cos(angle + k * 2.1), 240 + 150 * np.sin(angle + k * 2.1))
            for k in range(3)
        ]
        result = lights.see(places, gap)
        gap = 0
        assert sorted(result.ids) == [1, 2, 3]
    assert all(m.state is DETECTED for m in result.markers)


def test_hundreds_of_lights_keep_their_numbers():
    start = np.array([(30 + 31 * (i % 20), 25 + 31 * (i // 20)) for i in range(300)], float)
    lights = Lights()
    for step in range(12):
        image = draw(start + np.array((2.0 * step, step)), radius=3)
        lights.stamp_ns += STEP_NS
        result = lights.pipeline.process(Image(image, 'mono8'), lights.stamp_ns)
        assert sorted(result.ids) == list(range(1, 301))
    assert result.status == ''


def test_too_many_lights_are_a_status():
    rng = np.random.default_rng(1)
    lights = Lights()
    lights.see([(100, 100), (300, 300)])
    noise = np.where(rng.random((480, 640)) < 0.04, 255, 0).astype(np.uint8)
    lights.stamp_ns += STEP_NS
    result = lights.pipeline.process(Image(noise, 'mono8'), lights.stamp_ns)
    assert 'clusters above the threshold' in result.status
    assert result.ids == (1, 2)


def test_noise_in_every_frame_does_not_pile_up():
    rng = np.random.default_rng(2)
    lights = Lights()
    for _ in range(25):
        image = np.where(rng.random((480, 640)) < 0.001, 255, 0).astype(np.uint8)
        lights.stamp_ns += STEP_NS
        result = lights.pipeline.process(Image(image, 'mono8'), lights.stamp_ns)
        assert len(result.markers) <= 400


def test_the_grouping_is_the_one_that_was_asked_for():
    """Two lights 9 px apart are one group of the thesis's and two pieces."""
    frame = Image(draw([(100, 100), (109, 100), (300, 300)], radius=2), 'mono8')

    def count(**parameters):
        return len(Lights(**parameters).pipeline.process(frame, STEP_NS).ids)

    assert count(grouping='distance') == 2
    assert count(grouping='distance', grouping_distance=2) > 3
    assert count(grouping='auto') == count(grouping='components') == 3


@pytest.mark.parametrize(('prediction', 'expected'), [('none', 220.0), ('velocity', 230.0)])
def test_the_prediction_is_the_one_that_was_asked_for(prediction, expected):
    """Seen in what takes a light for another one: near its prediction, or not."""
    lights = Lights(prediction=prediction)
    for step in range(13):
        result = lights.see([(100 + 10 * step, 100)])
    assert result.ids == (1,)
    predictor = lights.pipeline._tracker._motion
    predicted = predictor.predict(13 * STEP_NS * 1e-9, prediction)
    assert predicted[0] == pytest.approx(expected, abs=0.1)

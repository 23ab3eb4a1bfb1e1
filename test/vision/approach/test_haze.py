"""What is far away in haze has its contrast back, where attitude says how far away it is."""

import numpy as np
import pytest
from support.drawn_ground import drawn_strip

from mvuav_ros.vision.approach.approach_detector import ApproachDetector
from mvuav_ros.vision.approach.attitude import Derotation, HorizonLine
from mvuav_ros.vision.approach.haze import Haze

HORIZON = 100
STEP_NS = 33_000_000


def drawn(frame):
    return drawn_strip(frame, height=60, width=30, speed=2, ends=(400, 1500))


def in_haze(image, rows, horizon=HORIZON):
    """With half of the contrast left so many rows below the horizon."""
    sky = image[horizon - 10 : horizon - 2].mean(axis=(0, 1))
    depth = np.maximum(np.arange(len(image)) - horizon, 0)
    left = np.where(depth > 0, np.exp2(-rows / np.maximum(depth, 1)), 1.0)
    left = left.reshape(-1, *[1] * (image.ndim - 1))
    return np.rint(sky + (image - sky) * left).astype(np.uint8)


@pytest.mark.parametrize('frame', [drawn(0), drawn(0)[..., 1]], ids=['colour', 'grey'])
def test_contrast_is_given_back(frame):
    hazy = in_haze(frame, 30)
    cleared = Haze().cleared(hazy, hazy, Derotation(320, 240, 1, 0.0), HORIZON)
    rows = slice(HORIZON + 20, HORIZON + 60)
    before, after, clear = (each[rows].std(axis=1).mean() for each in (hazy, cleared, frame))
    assert before < 0.6 * clear
    assert after == pytest.approx(clear, rel=0.2)
    np.testing.assert_array_equal(cleared[: HORIZON - 1], hazy[: HORIZON - 1])


def test_a_slanted_horizon_and_a_frame_that_is_twice_as_large():
    hazy = in_haze(drawn(0)[..., 1], 30)
    straight = Haze().cleared(hazy, hazy, Derotation(320, 240, 1, 0.0), HORIZON)
    larger = hazy.repeat(2, axis=0).repeat(2, axis=1)
    twice = Haze().cleared(larger, hazy, Derotation(320, 240, 2, 0.0), HORIZON)
    assert np.abs(twice[::2, ::2].astype(int) - straight)[HORIZON + 5 :].mean() < 2.0
    level = Derotation(320, 240, 1, 0.3)
    turned = Derotation(320, 240, 1, -0.3).turned(hazy)
    back = level.turned(Haze().cleared(turned, turned, level, HORIZON))
    middle = np.s_[HORIZON + 8 : 200, 100:220]
    assert np.abs(back.astype(int) - straight)[middle].mean() < 4.0


@pytest.mark.parametrize('row', [HORIZON, -50.0, 3.0, 235.0, 1e9, float('inf')])
def test_a_clear_frame_is_left_alone(row):
    frame = drawn(0)
    assert Haze().cleared(frame, frame, Derotation(320, 240, 1, 0.0), row) is frame


def test_a_frame_of_grey_levels_among_colours():
    """As a camera's black frame is taken."""
    haze, level, hazy = Haze(), Derotation(320, 240, 1, 0.0), in_haze(drawn(0), 30)
    haze.cleared(hazy, hazy, level, HORIZON)
    grey = in_haze(drawn(0)[..., 1], 30)
    alone = Haze().cleared(grey, grey, level, HORIZON)
    among = haze.cleared(grey, grey, level, HORIZON)
    assert among.shape == grey.shape
    assert np.abs(among.astype(int) - alone)[HORIZON + 5 :].mean() < 12.0
    assert haze.cleared(hazy, hazy, level, HORIZON).shape == hazy.shape


def test_a_runway_in_haze_is_found(monkeypatch):
    """Without it in none of these frames."""

    def found():
        detector = ApproachDetector()
        lines = HorizonLine(float(HORIZON), 0.0)
        images = (in_haze(drawn(frame), 60) for frame in range(30))
        results = (detector.process(each, i * STEP_NS, lines) for i, each in enumerate(images))
        return sum(result.confidence > 0.5 for result in results)

    assert found() > 20
    monkeypatch.setattr(Haze, 'cleared', lambda haze, image, *_: image)
    assert found() == 0

"""Stamps that are no even steps: late ones, another rate, gaps of years."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.marker_scenes import draw, tanker_at

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.approach.approach_detector import ApproachDetector
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.motion import MotionPredictor
from mvuav_ros.vision.markers.tracker import MarkerTracker
from mvuav_ros.vision.runway.detector import RunwayDetector

STEP = 1 / 30


def errors(times: list[float]) -> list[float]:
    """Of the predictions of a light that sways, px, frame by frame."""
    predictor, found = MotionPredictor(1), []
    for time in times:
        place = 320 + 100 * math.sin(2 * time), 240 + 60 * math.cos(2 * time)
        predicted = predictor.predict(time)
        found.append(math.dist(predicted, place))
        predictor.update(place)
    return found


@pytest.mark.parametrize('gap', [1e-4, 5e-4, 1e-3, 2e-3, 4e-3, 8e-3])
def test_one_late_stamp_is_forgotten(gap: float) -> None:
    times = [number * STEP for number in range(150)]
    usual = max(errors(times)[40:])
    times[30] = times[31] - gap
    late = errors(times)
    # The place of that frame is another one than its stamp says.
    assert max(late[35:]) < 3.0 * usual + 0.5
    assert max(late[60:]) < 1.5 * usual + 0.05


@pytest.mark.parametrize('gap', [1e-6, 2e-5, 1e-3])
def test_a_first_interval_that_is_too_short_is_no_rate(gap: float) -> None:
    """As of a camera's first image, which waited in a buffer: it was the step of all gains."""
    times = [0.0, *(gap + number * STEP for number in range(100))]
    assert max(errors(times)[2:]) < 5.0
    assert max(errors(times)[30:]) < 0.5


@pytest.mark.parametrize('factor', [0.25, 4, 5])
def test_another_rate_is_learnt(factor: float) -> None:
    step = STEP * factor
    usual = max(errors([number * step for number in range(120)])[60:])
    times = [number * STEP for number in range(60)]
    times += [times[-1] + number * step for number in range(1, 120)]
    assert max(errors(times)[120:]) < 1.3 * usual + 0.02


@pytest.mark.parametrize('prediction', ['kalman', 'velocity'])
def test_a_gap_of_years_and_stamps_a_nanosecond_apart(prediction: str) -> None:
    tracker = MarkerTracker(MarkerTrackerParameters(prediction=prediction))
    frame = Image(draw(tanker_at()), 'mono8')
    stamps = [*range(0, 300_000_000, 33_000_000), *(10**17 + n for n in (0, 1, 3, 33_000_000))]
    results = [tracker.process(frame, stamp_ns) for stamp_ns in stamps]
    assert np.isfinite([(m.x, m.y) for m in results[-1].markers]).all()


@pytest.mark.parametrize('kind', [MarkerTracker, RunwayDetector, ApproachDetector])
def test_stamps_are_whole_numbers_of_any_type(
    kind: type[MarkerTracker | RunwayDetector | ApproachDetector],
) -> None:
    """A float is seconds, and unsigned numbers of NumPy are never negative."""
    frame = draw(tanker_at())
    detector = kind()
    with pytest.raises(TypeError):
        detector.process(frame, 0.033)  # type: ignore[arg-type]
    detector.process(frame, 7)
    with pytest.raises(ValueError, match='stamp 5 ns is'):
        detector.process(frame, np.uint64(5))  # type: ignore[arg-type]


@pytest.mark.parametrize('kind', [MarkerTracker, RunwayDetector, ApproachDetector])
@pytest.mark.parametrize('step', [1, 40, 999])
def test_numbers_of_frames_and_milliseconds_are_no_nanoseconds(
    kind: type[MarkerTracker | RunwayDetector | ApproachDetector], step: int
) -> None:
    """A velocity of them would be a million times too high."""
    frame, detector = draw(tanker_at()), kind()
    said = f'{step} ns after the frame before: is the stamp in ns?'
    first, second, third = (detector.process(frame, n).status for n in (0, step, step + 1000))
    assert said not in first and second.endswith(said) and 'is the stamp' not in third


@pytest.mark.parametrize('kind', [MarkerTracker, RunwayDetector, ApproachDetector])
def test_a_stamp_may_come_again_where_nothing_has_a_velocity(
    kind: type[MarkerTracker | RunwayDetector | ApproachDetector],
) -> None:
    frame, detector = draw(tanker_at()), kind()
    detector.process(frame, 40)
    if isinstance(detector, MarkerTracker):
        with pytest.raises(ValueError, match='40 ns is not later'):
            detector.process(frame, 40)
    else:
        assert 'is the stamp' not in detector.process(frame, 40).status

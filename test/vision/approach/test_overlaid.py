"""What is laid over the view stands still while the ground moves."""

import cv2
import numpy as np
import pytest
from support.drawn_ground import drawn_strip

from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.vision.approach.approach_detector import ApproachDetector
from mvuav_ros.vision.approach.ground_motion import Overlaid

HORIZON = 60
TEXT = (20, 190, 150, 214)
"""First column and row, and those after the last, of the text."""


def ground(index, turn=0.0, size=8.0):
    """A plane of fields of a size, seen from an aircraft that flies on, and turns by px a frame."""
    count = round(1200 / size)
    grey = np.random.default_rng(7).integers(40, 150, (count, count), np.uint8)
    fields = cv2.resize(grey, (1200, 1200))
    rows = np.arange(HORIZON + 4, 240)
    depth = 3000.0 / (rows - HORIZON)
    across = (np.arange(320) - 160 - turn * index) / 300.0
    x = (600 + depth[:, None] * across * 6) % 1199
    y = (600 + 6 * depth + 1.2 * index)[:, None] % 1199 + 0 * x
    image = np.full((240, 320), 220, np.uint8)
    image[HORIZON + 4 :] = cv2.remap(
        fields, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR
    )
    return image


def with_text(image):
    cv2.putText(image, 'ALT 1200', (22, 210), cv2.FONT_HERSHEY_SIMPLEX, 0.7, 255, 2)
    return image


def seen(images):
    overlaid = Overlaid()
    for image in images:
        overlaid.take(image)
    return overlaid.mask


@pytest.mark.parametrize('turn', [0.0, 1.5])
def test_text_is_told_from_the_ground_that_moves(turn):
    mask = seen(with_text(ground(index, turn)) for index in range(40))
    left, top, right, bottom = TEXT
    assert mask is not None
    assert (mask[top + 4 : bottom - 4, left + 4 : right - 20] > 0).mean() > 0.8
    ground_alone = mask.copy()
    ground_alone[top - 16 : bottom + 16, max(left - 16, 0) : right + 16] = 0
    assert (ground_alone[HORIZON:] > 0).mean() < 0.05


def test_nothing_is_overlaid_where_everything_moves_or_nothing_does():
    mask = seen(ground(index, 1.5) for index in range(40))
    assert mask is None or (mask[HORIZON:] > 0).mean() < 0.05
    assert seen([with_text(ground(0))] * 40) is None


def test_digits_that_change_on_a_picture_that_stands_still_hide_nothing():
    """Between their corners there may be a map as well, but it explains nothing."""

    def still(index):
        image = ground(0)
        for row in range(4):
            words = f'{731 * (index + row) % 10000:04d} {37 * index % 100:02d}'
            place = (10 + 70 * row, 100 + 40 * row)
            cv2.putText(image, words, place, cv2.FONT_HERSHEY_SIMPLEX, 0.6, 255, 2)
        return image

    assert seen(still(index) for index in range(60)) is None


def test_a_reticle_around_a_runway_does_not_hide_it():
    detector = ApproachDetector(RunwayDetectorParameters(mode='approach'))
    confidences = []
    for index in range(60):
        image = drawn_strip(index, height=20, width=30, speed=1, ends=(400, 1500))
        cv2.circle(image, (160, 124), 24, (255, 255, 255), 1, cv2.LINE_AA)
        confidences.append(detector.process(image, index).confidence)
    assert min(confidences[30:]) > 0.5


def fixed_strip(image):
    """A runway with dashed sides and a threshold, as a display would lay it over the view."""
    pavement = np.array([(150, 80), (170, 80), (210, 150), (110, 150)])
    cv2.fillPoly(image, [pavement], 70, cv2.LINE_AA)
    for (x1, y1), (x2, y2) in (pavement[[0, 3]], pavement[[1, 2]]):
        x, y = np.linspace((x1, y1), (x2, y2), 15).round().astype(int).T.tolist()
        for dash in range(0, 14, 2):
            ends = (x[dash], y[dash]), (x[dash + 1], y[dash + 1])
            cv2.line(image, *ends, 255, 3, cv2.LINE_AA)
    for number in range(8):
        cv2.line(image, (120 + 11 * number, 146), (124 + 11 * number, 136), 255, 2, cv2.LINE_AA)
    return image


@pytest.mark.parametrize('turn', [0.8, 1.5, 2.5])
def test_a_runway_that_is_painted_on_the_picture_is_none(turn):
    detector = ApproachDetector(RunwayDetectorParameters(mode='approach', min_confidence=0.0))
    results = [detector.process(fixed_strip(ground(index, turn)), index) for index in range(60)]
    # It takes some frames until the ground has moved enough.
    for result in results[40:]:
        assert result.confidence < 0.05
    for result in results[50:]:
        assert result.corners is None or abs(result.corners[0][0] - 112) > 15


def outlined(image, sides):
    """A runway's outline of plain lines, along which hardly more than the ends are corners."""
    corners = np.array([(150, 80), (170, 80), (210, 150), (110, 150)])
    for first in range(0, 4, 4 // sides):
        ends = corners[first - 1].tolist(), corners[first].tolist()
        cv2.line(image, *ends, (255,) * 3, 2, cv2.LINE_AA)
    return image


@pytest.mark.parametrize('colour', [True, False], ids=['colour', 'grey'])
@pytest.mark.parametrize(
    ('turn', 'sides', 'size'),
    [(0.4, 4, 8.0), (-0.4, 2, 8.0), (0.6, 2, 16.0), (0.8, 4, 24.0), (1.5, 2, 8.0)],
)
def test_an_outline_that_is_drawn_into_the_picture_is_none(turn, sides, size, colour):
    """Its lines stand still while the ground moves across them; no other thing is a runway."""
    detector = ApproachDetector(RunwayDetectorParameters(mode='approach', min_confidence=0.0))
    confidences = []
    for index in range(60):
        image = cv2.cvtColor(ground(index, turn, size), cv2.COLOR_GRAY2BGR)
        if colour:
            image = np.clip(image * (0.6, 1.0, 0.9), 0, 255).astype(np.uint8)
        image = outlined(image, sides)
        image = image if colour else np.ascontiguousarray(image[:, :, 1])
        confidences.append(detector.process(image, index).confidence)
    assert max(confidences[:12]) > 0.5
    assert max(confidences[36:]) < 0.05


def test_a_runway_whose_edges_stand_still_is_followed():
    """Flown along, they look the same in every frame, as what is laid over the view does."""
    detector = ApproachDetector(RunwayDetectorParameters(mode='approach'))
    for index in range(45):
        image = drawn_strip(index, height=20, width=30, speed=2, ends=(-50, 900))
        result = detector.process(image, index)
        if index > 25:
            assert result.corners is not None
            near_left, near_right, *_ = result.corners
            truth = 160.0 + np.array((-0.75, 0.75)) * (near_left[1] - 100.0)
            assert (near_left[0], near_right[0]) == pytest.approx(truth, abs=6.0)

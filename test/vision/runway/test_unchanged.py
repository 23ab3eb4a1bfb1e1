"""Mode thesis gives what it gave before mode approach existed."""

import hashlib

import numpy as np

from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.vision.runway.detector import RunwayDetector

# Of the outputs of commit dc6fe73, which had no mode.
BEFORE = '6a803674564f85efb76f6b7967d41932d0df2045ebe360c9fd2ed56c15b2cb90'
NUMBERS = ('rho', 'theta', 'votes', 'rho_raw', 'theta_raw', 'x', 'y', 'x2', 'y2')


def frames():
    """Three lines that move, noise, and one frame without anything; drawn without OpenCV."""
    rng = np.random.default_rng(2006)
    y, x = np.mgrid[:240, :320]
    for index in range(40):
        image = np.full((240, 320, 3), 90, np.uint8)
        if index != 20:
            image += rng.integers(0, 6, image.shape, dtype=np.uint8)
            for middle in (140 + index - (y - 20) / 3, 160 + index + (y - 20) / 2.5):
                image[np.abs(x - middle) < 2.5] = (60, 70, 200)
            image[np.abs(y - 100 - index % 7) < 1.5] = (80, 90, 180)
        yield image


def fingerprint(pipeline) -> str:
    digest = hashlib.sha256()
    for index, frame in enumerate(frames()):
        for line in pipeline.process(frame, index).lines:
            numbers = [getattr(line, name) for name in NUMBERS]
            digest.update(np.round(numbers, 6).astype('<f8').tobytes())
            peak = -1 if line.peak is None else line.peak
            digest.update(bytes([peak + 1, int(line.flags)]))
    return digest.hexdigest()


def test_thesis_mode_is_unchanged():
    assert fingerprint(RunwayDetector(RunwayDetectorParameters(mode='thesis'))) == BEFORE


def test_another_result_has_another_fingerprint():
    other = RunwayDetectorParameters(rho_error_threshold=29.0, theta_error_threshold_deg=0.9)
    assert fingerprint(RunwayDetector(other)) != BEFORE

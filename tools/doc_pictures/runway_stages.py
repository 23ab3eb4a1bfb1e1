"""Both runway pipelines on one frame, and what the parameters of the thesis's scheme do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from doc_pictures.style import image_row, save
from mvuav_ros import ApproachDetector, RunwayDetector
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.sources.opening import make_flight
from mvuav_ros.vision.approach.evidence import gather_evidence, shrink_levels
from mvuav_ros.vision.approach.overlay import draw_approach
from mvuav_ros.vision.runway.debug_images import draw_confined, draw_edges, draw_hough, draw_overlay
from mvuav_ros.vision.runway.edges import detect_edges
from mvuav_ros.vision.runway.results import RunwayResult

_SIZE = (320, 240)
_LOW_PASS = {
    'frames': 40,
    'fps': 15,
    'width': 320,
    'height': 240,
    'motion': 'low_pass',
    'start_distance': -20.0,
    'speed': 25.0,
    'camera_pitch_deg': 20.0,
    'noise': 1.0,
}
_APPROACH = {
    'frames': 30,
    'fps': 10,
    'width': 320,
    'height': 240,
    'start_distance': 310.0,
    'runway_width': 30.0,
}
_TUNED = {'start_row': 40, 'end_row': 240, 'num_peaks': 2}


def thesis_pipeline(path: Path) -> None:
    """Confined rows, edges, opened edges, accumulator, lines."""
    result = _run({})
    gray = draw_confined(result)
    edges = detect_edges(gray) * np.uint8(255)
    images = [
        _frames()[-1],
        _on_frame(gray, result),
        _on_frame(edges, result),
        _on_frame(draw_edges(result), result),
        cv2.resize(draw_hough(result), _SIZE, interpolation=cv2.INTER_AREA),
        draw_overlay(result),
    ]
    titles = [
        '1  frame',
        '2  rows 40 to 239, red channel',
        '3  Sobel edges',
        '4  opening: short runs removed',
        '5  Hough accumulator, two peaks',
        '6  lines, checked against the last frame',
    ]
    save(image_row(images, titles), path)


def approach_pipeline(path: Path) -> None:
    """Evidence, horizon and vanishing point, the shape, the guidance."""
    flight = make_flight('runway', _APPROACH)
    detector = ApproachDetector(RunwayDetectorParameters(mode='approach', runway_width=30.0))
    detector.set_camera(flight.camera)
    result: Any = None
    for frame in flight:
        result = detector.process(frame.image.bgr(), frame.stamp_ns)
    small, _ = shrink_levels(result.image)
    evidence = gather_evidence(small).evidence
    steps = np.clip(128 + 2 * evidence[..., 0].astype(int), 0, 255).astype(np.uint8)
    searched = cv2.cvtColor(cv2.cvtColor(result.image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    if result.horizon is not None:
        first, last = (tuple(round(v) for v in point) for point in result.horizon)
        cv2.line(searched, first, last, (255, 120, 0), 1, cv2.LINE_AA)
    if result.corners is not None:
        far = tuple(round(v) for v in result.vanishing_point)
        for corner, color in zip(result.corners[:2], ((60, 60, 255), (80, 230, 60)), strict=True):
            cv2.line(searched, far, tuple(round(v) for v in corner), color, 1, cv2.LINE_AA)
    images = [
        draw_approach(result),
        *(_near_runway(each) for each in (result.image, steps, searched)),
    ]
    titles = [
        'the frame, with what is reported',
        '1  part of the frame, magnified',
        '2  evidence: brighter (white) or darker\n(black) to the right',
        '3  horizon, vanishing point and\nthe likeliest pair of edges',
    ]
    save(image_row(images, titles), path)


def _near_runway(image: np.ndarray) -> np.ndarray:
    """The middle of the frame, magnified to its size."""
    part = image[70:130, 120:200]
    return cv2.resize(part, _SIZE, interpolation=cv2.INTER_NEAREST)


def runway_parameters(path: Path, name: str) -> None:
    """Too low, right, too high."""
    images, titles = [], []
    for given, word in _CHOICES[name]:
        result = _run(given)
        if name in ('edge_threshold', 'opening_length'):
            images.append(_on_frame(draw_edges(result), result))
        elif name == 'peak_neighborhood':
            images.append(cv2.resize(draw_hough(result), _SIZE, interpolation=cv2.INTER_AREA))
        else:
            images.append(draw_overlay(result))
        values = ', '.join(f'{key} {value}' for key, value in given.items())
        titles.append(f'{values.replace("peak_neighborhood_", "")}:\n{word}')
    save(image_row(images, titles), path)


_CHOICES: dict[str, list[tuple[dict[str, Any], str]]] = {
    'edge_threshold': [
        ({'edge_threshold': 0.01}, 'too low: texture votes'),
        ({'edge_threshold': 0.08}, 'right'),
        ({'edge_threshold': 0.2}, 'too high: edges break'),
    ],
    'opening_length': [
        ({'opening_length': 1}, 'off: noise stays'),
        ({'opening_length': 3}, 'right'),
        ({'opening_length': 7}, 'too long: slanted edges vanish'),
    ],
    'peak_neighborhood': [
        (
            {'peak_neighborhood_rho': 1, 'peak_neighborhood_theta': 1, 'num_peaks': 4},
            'too small: one line, found several times',
        ),
        (
            {'peak_neighborhood_rho': 11, 'peak_neighborhood_theta': 11, 'num_peaks': 4},
            'right: different lines',
        ),
        (
            {'peak_neighborhood_rho': 151, 'peak_neighborhood_theta': 121, 'num_peaks': 4},
            'too large: lines hide each other',
        ),
    ],
    'rows': [
        ({'start_row': 0, 'end_row': 60}, 'too high: horizon and fields'),
        ({'start_row': 40, 'end_row': 240}, 'right: the runway fills the rows'),
        ({'start_row': 210, 'end_row': 240}, 'too few rows: short edges'),
    ],
}


def _frames() -> list[np.ndarray]:
    if not _FRAMES:
        _FRAMES.extend(frame.image.bgr() for frame in make_flight('runway', _LOW_PASS))
    return _FRAMES


_FRAMES: list[np.ndarray] = []


def _run(given: dict[str, Any]) -> RunwayResult:
    detector = RunwayDetector(RunwayDetectorParameters(**{**_TUNED, **given}))
    for number, frame in enumerate(_frames()):
        result = detector.process(frame, number * 66_000_000)
    return result


def _on_frame(rows: np.ndarray, result: RunwayResult) -> np.ndarray:
    """The rows searched, at their place on an empty frame."""
    canvas = np.full((result.height, result.width), 90, np.uint8)
    first, last = result.rows
    canvas[first:last] = rows[:, :] if rows.ndim == 2 else rows[..., 0]
    return canvas

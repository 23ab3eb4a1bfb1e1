"""One recording by several threads: the same messages in the same order as by one."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.calibrations import calibration_sample
from support.commands import NO_LIGHT, mvuav_process, read, write_flight
from support.recording_samples import (
    START_NS,
    STEP_NS,
    STORE,
    Sample,
    cdr,
    image,
    write_mcap,
)

from mvuav_ros.messages.images import Frame
from mvuav_ros.offline.replay.pipeline import make_processors, replay
from mvuav_ros.sources.source import SourceError
from mvuav_ros.vision.image import Image

IMAGE, COMPRESSED = '/camera/image_raw', '/camera/image_raw/compressed'


def header(number: int) -> object:
    return image(number).header


def compressed(number: int, size: tuple[int, int] = (96, 128), *, broken: bool = False) -> Sample:
    """A spot that wanders, as a JPEG."""
    pixels = np.zeros((*size, 3), np.uint8)
    cv2.circle(pixels, (20 + number % 60, 40), 4, (255, 255, 255), -1)
    data = cv2.imencode('.jpg', pixels)[1].ravel()
    kind = 'sensor_msgs/msg/CompressedImage'
    message = STORE.types[kind](header(number), 'jpeg', data[:40] if broken else data)
    return Sample(COMPRESSED, kind, START_NS + number * STEP_NS, cdr(message))


def both(bag: Path, folder: Path, *options: object) -> list[tuple[int, str]]:
    """The exit status and words of a run by one thread and of one by three."""
    said = []
    for jobs in (1, 3):
        run = mvuav_process('replay', bag, '-o', folder / f'{jobs}.mcap', '--jobs', jobs, *options)
        said.append((run.status, run.err))
    return said


def test_damaged_frames_calibrations_and_copies(tmp_path: Path) -> None:
    samples = []
    for number in range(60):
        broken, size = number % 7 == 3, ((96, 128) if number < 40 else (480, 640))
        samples.append(compressed(number - (number == 20), size, broken=broken))
        if number % 5 != 2:
            samples.append(calibration_sample(number, 100.0, (128, 96)))
    bag = write_mcap(tmp_path / 'bag.mcap', samples)
    first, second = both(bag, tmp_path, '--keep-inputs', '--debug-images')
    assert first == second
    assert first[0] == 0 and 'the stamp of the frame before' in first[1]
    assert 'no calibration comes with the images' not in first[1]
    one, three = read(tmp_path / '1.mcap'), read(tmp_path / '3.mcap')
    assert {message.topic for message in one} > {COMPRESSED, '/marker_tracker/debug_image'}
    assert one == three


@pytest.mark.parametrize('node', ['marker_tracker', 'marker_tracker,runway_detector'])
def test_raw_images(tmp_path: Path, node: str) -> None:
    bag = write_flight(tmp_path / 'flight.mcap', 150)
    notes = NO_LIGHT
    if 'runway' in node:
        notes += 'note: runway_detector, every frame: rows 50 to 130 are outside the 48 rows\n'
    assert both(bag, tmp_path, '--nodes', node, '--every', 2) == [(0, notes), (0, notes)]
    assert read(tmp_path / '1.mcap') == read(tmp_path / '3.mcap')


@pytest.mark.long
def test_simulated_flight(tmp_path: Path) -> None:
    notes = 'note: marker_tracker, every frame: 11 % of the frame is above the threshold\n'
    assert both('sim:runway?frames=12', tmp_path) == [(0, notes), (0, notes)]
    assert read(tmp_path / '1.mcap') == read(tmp_path / '3.mcap')


def test_not_a_single_frame(tmp_path: Path) -> None:
    bag = write_mcap(tmp_path / 'bag.mcap', [compressed(n, broken=True) for n in range(9)])
    first, second = both(bag, tmp_path)
    assert (first[0], second[0]) == (1, 1)
    assert 'not a single frame could be used' in second[1]


def test_an_error_of_the_input_and_an_end_in_the_midst_leave_no_thread_behind() -> None:
    processors = make_processors({'marker_tracker': {}})
    frames = [Frame(n, 'camera', Image(np.zeros((48, 64), np.uint8), 'mono8')) for n in range(40)]

    def broken() -> Iterator[Frame]:
        yield from frames
        raise SourceError('no more')

    steps = replay(broken(), processors, threads=3)
    with pytest.raises(SourceError, match='no more'):
        list(steps)
    steps = replay(frames, make_processors({'marker_tracker': {}}), threads=3)
    assert next(steps).stamp_ns == 0
    steps.close()
    assert not [thread for thread in threading.enumerate() if 'decoding' in thread.name]

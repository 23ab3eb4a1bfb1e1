"""Reading ahead and serialization, which every replay goes through."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from mvuav_ros.messages.image_encoding import encode_image
from mvuav_ros.processing.serialization import serialize
from mvuav_ros.replaying.prefetching import prefetched
from mvuav_ros.sources.frame import Frame
from mvuav_ros.vision.picture import Picture

PICTURE = Picture(np.zeros((2, 2), np.uint8), 'mono8')


def frames(count: int) -> Iterator[Frame]:
    for index in range(count):
        yield Frame(index, '', PICTURE)


@pytest.mark.parametrize('count', [0, 1, 1000])
def test_all_items_in_order(count: int) -> None:
    assert [frame.stamp_ns for frame in prefetched(frames(count))] == list(range(count))
    assert list(prefetched(iter(range(count)))) == list(range(count))


def test_an_error_comes_where_its_item_would_have_come() -> None:
    def broken() -> Iterator[Frame]:
        yield from frames(3)
        raise ValueError('broken')

    items = prefetched(broken())
    assert [next(items).stamp_ns for _ in range(3)] == [0, 1, 2]
    with pytest.raises(ValueError, match='broken'):
        next(items)


def test_it_is_only_a_few_frames_ahead_and_ends_when_closed() -> None:
    made = []

    def counted() -> Iterator[Frame]:
        for frame in frames(1000):
            made.append(frame)
            yield frame

    before = threading.active_count()
    with closing(prefetched(counted())) as items:
        next(items)
        end = time.monotonic() + 0.5
        while len(made) < 3 and time.monotonic() < end:
            time.sleep(0.01)
        assert threading.active_count() == before + 1
        time.sleep(0.05)
        assert 3 <= len(made) <= 8
    assert threading.active_count() == before


def diagnostics() -> DiagnosticArray:
    return DiagnosticArray(
        header=Header(stamp=Time(sec=1, nanosec=2), frame_id='nose'),
        status=[
            DiagnosticStatus(
                level=DiagnosticStatus.WARN, name='ab', values=[KeyValue(key='k', value='value')]
            ),
            DiagnosticStatus(),
        ],
    )


def picture() -> Image:
    pixels = np.arange(35, dtype=np.uint8).reshape(5, 7)
    return encode_image(Picture(pixels, 'mono8'), Header(frame_id='x'))


@pytest.mark.parametrize('make', [diagnostics, picture])
def test_serialization_is_that_of_rclpy_with_zeros_as_padding(make) -> None:
    # Fills the memory that the next serialization gets with something else.
    noise = [b'\xff' * size for size in range(32, 256)]
    theirs, ours = serialize_message(make()), serialize(make())
    del noise
    assert len(ours) == len(theirs)
    assert deserialize_message(ours, type(make())) == make()
    differing = [a for a, b in zip(ours, theirs, strict=True) if a != b]
    assert set(differing) <= {0}
    assert ours == serialize(make())

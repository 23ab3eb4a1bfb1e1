"""Reading ahead, which every replay does."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest

from mvuav_ros.offline.replay.prefetching import prefetched
from mvuav_ros.recordings.sources.frame import Frame
from mvuav_ros.vision.image import Image

PICTURE = Image(np.zeros((2, 2), np.uint8), 'mono8')


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

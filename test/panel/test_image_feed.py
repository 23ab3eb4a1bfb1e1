"""Images as they are sent to the pages."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

pytest.importorskip('nicegui', reason='the extra panel is not installed')

from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.images import serialize_image
from mvuav_ros.panel import image_feed
from mvuav_ros.panel.image_feed import ImageFeed, ImageStream, encode_jpeg
from mvuav_ros.panel.ros_thread import OtherTypeError
from mvuav_ros.vision.image import Image

STREAM = ImageStream('/tracker', 'input', '/image_raw')


def message(value, stamp_ns=0):
    image = Image(np.full((4, 6), value, np.uint8), 'mono8')
    return bytes(serialize_image(image, cdr_header(stamp_ns, 'camera')))


@pytest.fixture
def topic(monkeypatch):
    """A topic without ROS: who takes its messages, whether that has ended, and the time, s."""
    topic = SimpleNamespace(take=None, closed=False, now=1000.0, kinds={})

    def subscribe(kind, name, take, _qos, *, raw):
        if topic.kinds.setdefault(name, kind) is not kind:
            raise OtherTypeError
        topic.take, topic.closed = take, False
        return lambda: setattr(topic, 'closed', True)

    topic.ros = SimpleNamespace(subscribe=subscribe, call_in_loop=lambda do, *given: do(*given))
    clock = SimpleNamespace(monotonic=lambda: topic.now, time=lambda: topic.now)
    monkeypatch.setattr(image_feed, 'time', clock)
    return topic


@pytest.mark.parametrize(
    ('size', 'sent'), [((1280, 960), (640, 480)), ((64, 48), (64, 48)), ((2000, 1), (640, 1))]
)
def test_what_is_larger_than_a_page_shows_is_sent_smaller(size, sent):
    jpeg = encode_jpeg(Image(np.zeros(size[::-1], np.uint8), 'mono8'))
    shown = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert shown.shape == sent[::-1]


def test_of_a_fast_topic_ten_images_a_second_are_sent(topic):
    feed, seen = ImageFeed(topic.ros), []
    feed.look(lambda _, data: seen.append(data), {STREAM})
    for _ in range(150):
        topic.take(message(7))
        topic.now += 1 / 15
    assert len(seen) == pytest.approx(100, abs=2)


def test_an_image_that_is_held_stays_for_a_while_and_nobody_looks_for_nothing(topic):
    feed, seen = ImageFeed(topic.ros), []

    def viewer(_, data):
        seen.append(data)

    feed.look(viewer, {STREAM})
    for value, age in ((1, 0.25), (2, -5.0), (3, 3600.0)):
        topic.take(message(value, round(1e9 * (topic.now - age))))
        topic.now += 1.0
    # The age counts where the stamp is of now.
    assert [b'ms' in data for data in seen] == [True, False, False] and b'250 ms' in seen[0]
    assert feed.image(STREAM.key).pixels[0, 0] == 3
    assert [feed.image(STREAM.key, number).pixels[0, 0] for number in (1, 2)] == [1, 2]
    assert feed.image('/other input') is None and not topic.closed
    feed.look(viewer, set())
    assert topic.closed and feed.image(STREAM.key) is None


def test_a_node_that_takes_a_topic_for_another_type_darkens_no_other(topic):
    """All images and curves of a page were gone, as its connection broke again and again."""
    feed, seen = ImageFeed(topic.ros), []
    right = ImageStream('/right', 'input', '/image_raw/compressed', compressed=True)
    wrong = ImageStream('/wrong', 'input', '/image_raw/compressed')
    feed.look(seen.append, {right})
    feed.look(seen.append, {right, wrong, STREAM})
    assert feed._taps.keys() == {right, STREAM} and not topic.closed
    topic.kinds.clear()
    feed.look(seen.append, {wrong})
    assert feed._taps.keys() == {wrong}

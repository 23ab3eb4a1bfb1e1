"""Image messages are decoded, judged, and their topic chosen."""

from __future__ import annotations

import random
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.coded_videos import compressed_image, compressed_video, ffmpeg_packet
from support.recording_samples import (
    IMAGE,
    START_NS,
    STORE,
    TOPIC,
    Sample,
    cdr,
    image,
    image_samples,
    string_sample,
    write_mcap,
)

from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.definitions import decode_message
from mvuav_ros.messages.images import (
    COMPRESSED_IMAGE,
    COMPRESSED_VIDEO,
    FFMPEG_PACKET,
    BadFrame,
    Frame,
    is_image_type,
    serialize_image,
)
from mvuav_ros.messages.sensors import CAMERA_INFO, IMU, encode_imu, topic_beside
from mvuav_ros.messages.untrusted import MalformedMessageError
from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.writing import RecordingWriter
from mvuav_ros.sources.bag import BagImages, choose_image_topic
from mvuav_ros.sources.opening import open_source
from mvuav_ros.sources.source import Selection
from mvuav_ros.vision.frames import Attitude
from mvuav_ros.vision.image import Image


def compressed(number: int, extension: str = '.jpg') -> bytes:
    pixels = np.full((48, 64), number, np.uint8)
    types = STORE.types
    header = types['std_msgs/msg/Header'](types['builtin_interfaces/msg/Time'](1, 2), 'camera')
    data = cv2.imencode(extension, pixels)[1].ravel()
    kind = {'.jpg': 'jpeg', '.png': 'png'}.get(extension, extension[1:])
    return cdr(types[COMPRESSED_IMAGE](header, kind, data))


@pytest.mark.parametrize('little_endian', [True, False])
@pytest.mark.parametrize('type_name', [IMAGE, 'sensor_msgs/Image'])
def test_image_is_decoded_without_copying_pixels(little_endian: bool, type_name: str) -> None:
    original = image(3)
    data = cdr(original, little_endian=little_endian)
    decoded = decode_message(type_name, data)
    assert decoded.data.dtype == np.uint8
    assert np.array_equal(decoded.data, original.data)
    for name in ('header', 'height', 'width', 'encoding', 'is_bigendian', 'step'):
        assert getattr(decoded, name) == getattr(original, name)
    if little_endian:
        pixels = decode_message(type_name, data).data
        assert np.shares_memory(pixels, np.frombuffer(data, np.uint8))


MATRIX = np.arange(9, dtype=np.float64)


def camera_info(seconds: int, nanoseconds: int) -> bytes:
    types = STORE.types
    stamp = types['builtin_interfaces/msg/Time'](seconds, nanoseconds)
    header = types['std_msgs/msg/Header'](stamp, 'camera')
    region = types['sensor_msgs/msg/RegionOfInterest'](0, 0, 0, 0, False)
    none, p = np.zeros(5), np.zeros(12)
    return cdr(
        types[CAMERA_INFO](header, 480, 640, 'plumb_bob', none, MATRIX, MATRIX, p, 0, 0, region)
    )


def test_compressed_image_and_camera_info() -> None:
    assert decode_message(COMPRESSED_IMAGE, compressed(7)).format == 'jpeg'
    decoded = decode_message(CAMERA_INFO, camera_info(1, 2))
    assert (decoded.width, decoded.height) == (640, 480)
    assert np.array_equal(decoded.k, MATRIX)


def test_a_calibration_whose_stamp_is_no_time_holds_as_in_live_nodes(tmp_path: Path) -> None:
    info = camera_info(START_NS // 10**9 - 9, 1_500_000_000)
    sample = Sample(topic_beside(TOPIC, 'camera_info'), CAMERA_INFO, START_NS, info)
    (frame,) = BagImages(write_mcap(tmp_path / 'bag.mcap', [sample, *image_samples(1)])).frames()
    assert isinstance(frame, Frame) and frame.camera is not None
    assert frame.camera.width == 640


def test_malformed_messages_raise_one_error() -> None:
    choose = random.Random(6)
    data = cdr(image(1, 8, 4))
    malformed = 0
    for _ in range(3000):
        damaged = bytearray(
            data[: choose.randrange(len(data) + 1)] if choose.random() < 0.5 else data
        )
        for _ in range(choose.randrange(4)):
            if damaged:
                damaged[choose.randrange(len(damaged))] = choose.randrange(256)
        try:
            decode_message(choose.choice([IMAGE, COMPRESSED_IMAGE, CAMERA_INFO]), bytes(damaged))
        except MalformedMessageError:
            malformed += 1
    assert 1000 < malformed < 3000
    with pytest.raises(MalformedMessageError, match='not known'):
        decode_message('no_such/msg/Type', data)


def test_only_image_types_are_images() -> None:
    assert is_image_type('sensor_msgs/Image')
    assert is_image_type(COMPRESSED_IMAGE)
    assert not is_image_type('stereo_msgs/msg/DisparityImage')
    assert not is_image_type(CAMERA_INFO)


def test_choice_of_topic(tmp_path: Path) -> None:
    one = write_mcap(tmp_path / 'one.mcap', [*image_samples(2), string_sample(3)])
    with open_recording(one) as recording:
        assert choose_image_topic(recording).name == TOPIC
        assert choose_image_topic(recording, TOPIC[1:]).name == TOPIC
        with pytest.raises(RecordingError, match=f'choose one of: {TOPIC}'):
            choose_image_topic(recording, '/note')
    packed = Sample('/camera/compressed', COMPRESSED_IMAGE, START_NS, compressed(1))
    two = write_mcap(tmp_path / 'two.mcap', [*image_samples(2), packed])
    with open_recording(two) as recording:
        with pytest.raises(RecordingError) as refusal:
            choose_image_topic(recording)
        assert f'{TOPIC} (Image, 2 messages), /camera/compressed (C' in str(refusal.value)
        assert choose_image_topic(recording, '/camera/compressed').type == COMPRESSED_IMAGE
        for wanted, chosen in ((None, TOPIC), ('/elsewhere', TOPIC), (packed.topic, packed.topic)):
            assert choose_image_topic(recording, wanted, or_first=True).name == chosen
    both = tmp_path / 'both.mcap'
    with RecordingWriter(both) as writer:
        for sample in (*image_samples(2), packed._replace(topic=TOPIC)):
            writer.write(*sample)
    images = BagImages(both)
    assert (images.topic, images.count, len([*images.frames()])) == (TOPIC, 3, 3)
    samples = [string_sample(1), *image_samples(1)]
    none = write_mcap(tmp_path / 'none.mcap', samples, encodings={TOPIC: 'protobuf'})
    with open_recording(none) as recording, pytest.raises(RecordingError) as refusal:
        choose_image_topic(recording)
    assert f'holds /note; skipped, as not CDR: {TOPIC} (protobuf)' in str(refusal.value)


@pytest.mark.parametrize(
    ('transport', 'kind', 'make'),
    [
        ('compressed', COMPRESSED_IMAGE, compressed_image),
        ('ffmpeg', FFMPEG_PACKET, ffmpeg_packet),
        ('foxglove', COMPRESSED_VIDEO, compressed_video),
    ],
)
def test_what_belongs_to_images_lies_beside_the_raw_ones(
    tmp_path: Path, transport: str, kind: str, make: Callable[..., bytes]
) -> None:
    """As live nodes have it, whatever the transport."""
    bag = tmp_path / 'bag.mcap'
    with RecordingWriter(bag) as writer:
        writer.write('/nose/camera_info', CAMERA_INFO, START_NS, b'')
        writer.write('/nose/imu', IMU, START_NS, b'')
        writer.write(f'/nose/image_raw/{transport}', kind, START_NS, make(b'', 'h264', START_NS))
    source = BagImages(bag)
    assert (source.camera_topic, source.imu_topic) == ('/nose/camera_info', '/nose/imu')


def test_the_attitude_of_another_topic_is_taken_where_it_is_named(tmp_path: Path) -> None:
    bag = tmp_path / 'bag.mcap'
    with RecordingWriter(bag) as writer:
        for topic in ('/imu', '/mavros/imu/data'):
            writer.write(topic, IMU, START_NS, b'')
        writer.write('/nose/image_raw', IMAGE, START_NS, cdr(image(1)))
    assert BagImages(bag).imu_topic == '/imu'
    assert BagImages(bag, None, 'mavros/imu/data').imu_topic == '/mavros/imu/data'
    with pytest.raises(
        RecordingError, match='imu topic /imu/data; there is /imu, /mavros/imu/data'
    ):
        open_source(bag, imu_topic='/imu/data')
    assert BagImages(bag, imu_topic='/imu/data', or_first=True).imu_topic == '/imu'


def test_the_calibration_of_another_topic_is_taken_where_it_is_named(tmp_path: Path) -> None:
    bag = tmp_path / 'bag.mcap'
    with RecordingWriter(bag) as writer:
        writer.write('/camera/camera_info', CAMERA_INFO, START_NS, b'')
        writer.write('/nose/image_raw', IMAGE, START_NS, cdr(image(1)))
    with closing(BagImages(bag)) as source:
        assert (source.camera_topic, source.camera_topics) == (None, ('/camera/camera_info',))
    with closing(open_source(bag, camera_info_topic='camera/camera_info')) as source:
        assert source.camera_topic == '/camera/camera_info'
    with pytest.raises(
        RecordingError, match='no camera_info topic /nose; there is /camera/camera_info'
    ):
        open_source(bag, camera_info_topic='/nose')


def test_images_without_a_stamp_count_from_their_recording(tmp_path: Path) -> None:
    bag = tmp_path / 'bag.mcap'
    stamps = [0, 0, 0, START_NS, 0, START_NS + 9]
    with RecordingWriter(bag) as writer:
        for number, stamp_ns in enumerate(stamps):
            header, pixels = cdr_header(stamp_ns, 'nose'), np.zeros((4, 4), np.uint8)
            data = serialize_image(Image(pixels, 'mono8'), header)
            writer.write('/image_raw', IMAGE, 1 + number, data)
    source = BagImages(bag)
    assert [frame.stamp_ns for frame in source.frames()] == [1, 2, 3, START_NS, 5, START_NS + 9]
    (said,) = source.account.warnings
    assert said.startswith('4 images have no stamp') and said.endswith('time of recording counts')


def test_the_first_image_of_a_part_has_its_attitude_from_before_it(tmp_path: Path) -> None:
    bag = tmp_path / 'bag.mcap'
    with RecordingWriter(bag) as writer:
        for number in range(10):
            stamp_ns = START_NS + number * 10_000_000
            seen = Attitude.from_roll_pitch(0.1 * number, 0.0)
            writer.write('/imu', IMU, stamp_ns, encode_imu(seen, cdr_header(stamp_ns, 'imu')))
            header, pixels = cdr_header(stamp_ns + 5_000_000, 'nose'), np.zeros((4, 4), np.uint8)
            data = serialize_image(Image(pixels, 'mono8'), header)
            writer.write('/image_raw', IMAGE, stamp_ns + 25_000_000, data)
    whole = list(BagImages(bag).items(attitude=True))
    part = list(BagImages(bag).items(Selection(start_s=0.05), attitude=True))
    assert part == whole[3:]


def test_of_images_that_are_cut_off_only_those_of_the_part_are_given(tmp_path: Path) -> None:
    bag = tmp_path / 'bag.mcap'
    with RecordingWriter(bag) as writer:
        for number in range(8):
            data = compressed_image(bytes(100), 'jpeg', START_NS + number)
            whole = number % 4 > 1
            writer.write('/compressed', COMPRESSED_IMAGE, 1, data if whole else data[:60])
    third = list(BagImages(bag).items(Selection(every=3)))
    assert [item.stamp_ns - START_NS for item in third] == [0, 3, 6]
    assert [isinstance(item, BadFrame) for item in third] == [True, False, False]


def test_the_calibration_of_images_that_are_missing_is_not_that_of_the_others(
    tmp_path: Path,
) -> None:
    bag, there = tmp_path / 'bag.mcap', '/camera/camera_info'
    with RecordingWriter(bag) as writer:
        writer.write(there, CAMERA_INFO, START_NS, b'')
        writer.write('/nose/image_raw', IMAGE, START_NS, cdr(image(1)))
    for images, expected in (('nose/image_raw', there), ('/tail/image_raw', None)):
        with closing(BagImages(bag, images, None, there, or_first=True)) as source:
            assert source.camera_topic == expected

"""Video files with their own times, and topics that carry a video's packets."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from support.coded_videos import (
    FLIPPED,
    HALF_TURNED,
    HEIGHT,
    MIRRORED,
    TRANSPOSED,
    WIDTH,
    compressed_image,
    compressed_video,
    ffmpeg_packet,
    image,
    number_in,
    packets,
    turn,
    write_video,
)
from support.recording_samples import START_NS

from mvuav_ros.messages.images import (
    COMPRESSED_VIDEO,
    FFMPEG_PACKET,
    BadFrame,
    CodedImage,
    Frame,
    VideoDecoder,
)
from mvuav_ros.recordings.summary import summarise
from mvuav_ros.recordings.writing import RecordingWriter
from mvuav_ros.sources.bag import BagImages
from mvuav_ros.sources.files import VideoFile, _Stamps
from mvuav_ros.sources.opening import open_source
from mvuav_ros.sources.source import BEGINNING_NS as FIRST
from mvuav_ros.sources.source import Selection, SourceError

TIMES_MS = [0, 33, 100, 101, 500, 12_947]
COMPRESSED_IMAGE = 'sensor_msgs/msg/CompressedImage'
TOPIC = '/camera/video'


@contextmanager
def coded(
    path: Path,
    codec: str,
    images: Iterable[np.ndarray],
    pixels: str = 'yuv420p',
    form: str = 'bgr24',
    *,
    times: Sequence[int] | None = None,
    gop: int = 10,
    **options: str,
) -> Iterator[list[av.Packet]]:
    """Packets of a video of 20 Hz, or given times; they are written as the block leaves them."""
    frames = [av.VideoFrame.from_ndarray(each, format=form) for each in images]
    for frame, time in zip(frames, times or range(len(frames)), strict=True):
        frame.pts, frame.time_base = time, Fraction(1, 20)
    with av.open(str(path), 'w') as container:
        stream = container.add_stream(codec, rate=20, options=options)
        stream.width, stream.height, stream.pix_fmt = frames[0].width, frames[0].height, pixels
        stream.codec_context.gop_size = gop
        made = [packet for frame in [*frames, None] for packet in stream.encode(frame)]
        yield made
        container.mux(made)


@pytest.mark.parametrize('suffix', ['.mp4', '.mkv', '.avi'])
def test_a_variable_rate_has_its_own_times(tmp_path: Path, suffix: str) -> None:
    source = VideoFile(write_video(tmp_path / f'a{suffix}', TIMES_MS))
    frames = list(source.frames())
    assert [frame.stamp_ns for frame in frames] == [time * 1_000_000 or FIRST for time in TIMES_MS]
    assert source.account.errors == []
    assert [number_in(frame.image.pixels) for frame in frames] == list(range(6))


@pytest.mark.parametrize('suffix', ['.mkv', '.avi'])
def test_a_video_cut_off_says_so(tmp_path: Path, suffix: str) -> None:
    whole = write_video(tmp_path / f'a{suffix}', range(0, 2000, 50))
    cut = tmp_path / f'cut{suffix}'
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size * 2 // 5])
    source = VideoFile(cut)
    frames = list(source.frames())
    assert 5 < len(frames) < 40
    assert 'the video ended' in source.account.errors[0]


def test_an_mp4_without_its_index_is_said_to_be_cut_off(tmp_path: Path) -> None:
    path = write_video(tmp_path / 'a.mp4', range(0, 2000, 50))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(SourceError, match=r'lacks the index at its end.*untrunc'):
        VideoFile(path)


def test_a_given_rate_replaces_the_times(tmp_path: Path) -> None:
    source = VideoFile(write_video(tmp_path / 'a.mp4', TIMES_MS), 10.0)
    assert [frame.stamp_ns for frame in source.frames()] == [n * 10**8 or FIRST for n in range(6)]


def test_a_part_says_how_many_frames_it_has() -> None:
    assert Selection(every=3).count(10, None) == 4
    assert Selection(start_s=1.0, duration_s=2.0, every=3).count(100, 10.0) == 7
    assert Selection(start_s=9.5, duration_s=2.0).count(100, 10.0) == 5
    assert Selection(start_s=1.0).count(100, None) is Selection().count(None, 10.0) is None


def test_a_steady_rate_is_freed_of_the_files_rounding(tmp_path: Path) -> None:
    times = [round(number * 1000 / 30) for number in range(31)]
    source = VideoFile(write_video(tmp_path / 'a.mkv', times))
    stamps = [frame.stamp_ns for frame in source.frames()]
    assert stamps == pytest.approx([number * 1e9 / 30 for number in range(31)], abs=1e6)
    assert len(set(stamps)) == 31
    # What is off by a tick is no rounding; a time that stands still or runs back goes on.
    ticks = _Stamps(20.0, Fraction(1, 1000))
    assert [ticks.of(pts) for pts in (0, 51, 51, 40)] == [1, 51_000_000, 101_000_000, 151_000_000]


def test_a_camera_that_was_turned(tmp_path: Path) -> None:
    path = write_video(tmp_path / 'a.mp4', [0, 50, 100])
    (plain, *_) = VideoFile(path).frames()
    turn(path)
    (turned, *_) = VideoFile(path).frames()
    assert (turned.image.width, turned.image.height) == (HEIGHT, WIDTH)
    # The matrix turns the picture by a quarter clockwise: left becomes top.
    np.testing.assert_array_equal(turned.image.pixels, np.rot90(plain.image.pixels, -1))


@pytest.mark.parametrize(('kind', 'bits'), [('gray16le', 16), ('gray12le', 12), ('gray', 8)])
def test_a_grey_video_of_more_bits_keeps_them(tmp_path: Path, kind: str, bits: int) -> None:
    path, dtype = tmp_path / 'a.mkv', np.uint8 if bits == 8 else np.uint16
    ramp = np.tile(np.arange(WIDTH, dtype=dtype) * 3, (HEIGHT, 1))
    with coded(path, 'ffv1', [ramp], kind, kind):
        pass
    (frame,) = VideoFile(path).frames()
    assert frame.image.encoding == ('bgr8' if bits == 8 else 'mono16')
    shown = frame.image.gray().astype(int) >> (16 - bits) % 8
    np.testing.assert_array_equal(shown, ramp)


@pytest.mark.parametrize('aspect', [Fraction(16, 15), Fraction(1), None])
def test_pixels_that_are_not_square_are_said_to_be_so(
    tmp_path: Path, aspect: Fraction | None
) -> None:
    """As of analogue cameras: a roll of 45 degrees is 43 in the image."""
    video = tmp_path / 'capture.mp4'
    with av.open(str(video), 'w') as container:
        stream = container.add_stream('mpeg4', rate=25)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, 'yuv420p'
        if aspect is not None:
            stream.codec_context.sample_aspect_ratio = aspect
        container.mux(stream.encode(av.VideoFrame.from_ndarray(image(0), format='bgr24')))
        container.mux(stream.encode(None))
    notes = VideoFile(video).account.warnings
    assert ['not square' in note for note in notes] == [True] * (aspect == Fraction(16, 15))
    assert notes == [] or 'its pixels are 16:15' in notes[0]


def test_a_video_under_another_name(tmp_path: Path) -> None:
    made = write_video(tmp_path / 'a.mp4', TIMES_MS)
    for name in ('video', 'video.dat', 'video.bag'):
        made = made.rename(tmp_path / name)
        assert len(list(open_source(str(made)).frames())) == 6


def test_a_text_is_no_video(tmp_path: Path) -> None:
    path = tmp_path / 'notes.txt'
    path.write_text('a flight\n' * 100)
    with pytest.raises(SourceError, match='not a video that FFmpeg can read'):
        open_source(str(path))


def test_a_codec_that_ffmpeg_does_not_know(tmp_path: Path) -> None:
    path = write_video(tmp_path / 'a.mp4', TIMES_MS)
    content = path.read_bytes()
    assert content.count(b'mp4v') == 1
    path.write_bytes(content.replace(b'mp4v', b'zzzz').replace(b'esds', b'free'))
    with pytest.raises(SourceError, match='not a video that FFmpeg can read'):
        open_source(str(path))


def bag_of(path: Path, kind: str, messages: list[bytes]) -> Path:
    with RecordingWriter(path) as writer:
        for number, data in enumerate(messages):
            writer.write(TOPIC, kind, START_NS + number, data)
    return path


def stamp_of(number: int) -> int:
    return START_NS + number * 50_000_000


@pytest.mark.parametrize(
    ('codec', 'make', 'kind', 'name'),
    [
        ('libx264', compressed_image, COMPRESSED_IMAGE, 'h264'),
        ('libx265', compressed_image, COMPRESSED_IMAGE, 'h265'),
        ('libx264', ffmpeg_packet, FFMPEG_PACKET, 'libx264'),
        ('libx265', ffmpeg_packet, FFMPEG_PACKET, 'hevc;yuv420p;bgr8;bgr8'),
        ('libx264', compressed_video, COMPRESSED_VIDEO, 'h264'),
    ],
)
def test_topics_of_video_packets(tmp_path: Path, codec: str, make, kind: str, name: str) -> None:
    messages = [make(data, name, stamp_of(n)) for n, data in enumerate(packets(codec, 12))]
    path = bag_of(tmp_path / 'a.mcap', kind, messages)
    frames = list(BagImages(path).frames())
    assert [frame.stamp_ns for frame in frames] == [stamp_of(number) for number in range(12)]
    assert all(isinstance(frame, Frame) and frame.frame_id == 'camera' for frame in frames)
    assert [number_in(frame.image.pixels) for frame in frames] == list(range(12))
    (topic,) = summarise(path).topics
    assert topic.images is not None and topic.images.malformed == 0
    ffmpegs_name = 'hevc' if '265' in codec else 'h264'
    assert topic.images.formats == [f'{WIDTH}x{HEIGHT} {ffmpegs_name} video']
    third = list(BagImages(path).items(Selection(every=3)))
    assert [number_in(frame.image.pixels) for frame in third] == [0, 3, 6, 9]
    # A part need not begin with a key frame.
    part = list(BagImages(path).items(Selection(start_s=3e-9, duration_s=6e-9)))
    assert [number_in(frame.image.pixels) for frame in part] == [3, 4, 5, 6, 7, 8]


@pytest.mark.parametrize(
    ('codec', 'options', 'needed'),
    [
        ('libx264', {}, [5, 6, 7]),
        ('libx265', {'x265-params': 'keyint=5:open-gop=0:bframes=0:log-level=none'}, [5, 6, 7]),
        ('libvpx-vp9', {'lag-in-frames': '0', 'deadline': 'realtime', 'crf': '5'}, [5, 6, 7]),
        ('libvpx', {'lag-in-frames': '0', 'deadline': 'realtime'}, [5, 6, 7]),
        # Of these, frames that are shown before a key frame may come behind it.
        ('libx265', {'x265-params': 'keyint=5:open-gop=1:bframes=0:log-level=none'}, range(8)),
        ('libx265', {'x265-params': 'keyint=3:open-gop=1:bframes=0:log-level=none'}, range(3, 8)),
        ('mpeg4', {'sc_threshold': '1000000000', 'g': '3'}, range(3, 8)),
    ],
)
def test_before_a_part_only_the_newest_groups_of_pictures_are_decoded(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    codec: str,
    options: dict[str, str],
    needed: Sequence[int],
) -> None:
    decoded: list[int] = []

    class Counting(VideoDecoder):
        def frames(self, packet: CodedImage, wanted: bool) -> Iterator[Frame | BadFrame]:
            decoded.append((packet.stamp_ns - START_NS) // 50_000_000)
            return super().frames(packet, wanted)

    monkeypatch.setattr('mvuav_ros.sources.bag.VideoDecoder', Counting)
    coded = packets(codec, 12, options=options)
    messages = [compressed_video(data, codec, stamp_of(n)) for n, data in enumerate(coded)]
    path = bag_of(tmp_path / 'a.mcap', COMPRESSED_VIDEO, messages)
    part = list(BagImages(path).items(Selection(start_s=8e-9, duration_s=2e-9)))
    assert [number_in(frame.image.pixels) for frame in part] == [8, 9]
    assert decoded == [*needed, 8, 9]


def test_frames_in_the_order_of_showing(tmp_path: Path) -> None:
    """With B-frames, packets come in another order; each frame has the stamp of its packet."""
    coded = packets('mpeg4', 9, b_frames=2)
    messages = [compressed_video(data, 'mpeg4', stamp_of(n)) for n, data in enumerate(coded)]
    path = bag_of(tmp_path / 'a.mcap', COMPRESSED_VIDEO, messages)
    frames = list(BagImages(path).frames())
    assert len(frames) == len(coded)


def test_packets_that_cannot_be_decoded(tmp_path: Path) -> None:
    coded = packets('libx264', 12)
    messages = [compressed_video(data, 'h264', stamp_of(n)) for n, data in enumerate(coded)]
    late = bag_of(tmp_path / 'late.mcap', COMPRESSED_VIDEO, messages[2:])
    frames = list(BagImages(late).frames())
    bad = [frame for frame in frames if isinstance(frame, BadFrame)]
    assert len(frames) == 10
    assert 1 <= len(bad) <= 3 and 'the frames before it' in bad[0].reason
    (topic,) = summarise(late).topics
    assert topic.images is not None
    assert topic.images.malformed == len(bad)
    assert topic.images.first_problem == bad[0].reason
    assert topic.images.formats == [f'{WIDTH}x{HEIGHT} h264 video']
    for data, reason in ((b'\0\0\0\1garbage', 'does not decode'), (b'', 'is empty')):
        messages = [compressed_video(data, 'h264', stamp_of(n)) for n in range(3)]
        none = bag_of(tmp_path / f'{len(data)}.mcap', COMPRESSED_VIDEO, messages)
        frames = list(BagImages(none).frames())
        assert all(isinstance(frame, BadFrame) and reason in frame.reason for frame in frames)
        (topic,) = summarise(none).topics
        assert topic.images is not None and topic.images.formats == []
        assert topic.images.malformed == len(frames) == 3 and reason in topic.images.first_problem
    messages = [compressed_video(b'\0\0\0\1garbage', 'theora', stamp_of(0))]
    other = bag_of(tmp_path / 'other.mcap', COMPRESSED_VIDEO, messages)
    (frame,) = BagImages(other).frames()
    assert "format 'theora' is not known" in frame.reason
    (topic,) = summarise(other).topics
    assert topic.images is not None and "'theora' is not known" in topic.images.first_problem


@pytest.mark.parametrize(
    ('matrix', 'shown'),
    [
        (MIRRORED, lambda pixels: pixels[:, ::-1]),
        (FLIPPED, lambda pixels: pixels[::-1]),
        (HALF_TURNED, lambda pixels: pixels[::-1, ::-1]),
        (TRANSPOSED, lambda pixels: pixels.swapaxes(0, 1)),
    ],
    ids=['mirrored', 'flipped', 'half turned', 'transposed'],
)
def test_a_video_stands_as_its_matrix_says(
    tmp_path: Path, matrix: bytes, shown: Callable[[Any], Any]
) -> None:
    path = write_video(tmp_path / 'a.mp4', [0, 33])
    plain = [frame.image.pixels for frame in VideoFile(path).frames()]
    turn(path, matrix)
    for frame, before in zip(VideoFile(path).frames(), plain, strict=True):
        assert np.array_equal(frame.image.pixels, shown(before))


def test_frames_of_a_video_do_not_pile_up(tmp_path: Path) -> None:
    """Those of 4K that waited for Python's search for cycles would take gigabytes."""
    video = VideoFile(write_video(tmp_path / 'a.mp4', range(0, 2000, 50)))
    gc.collect()
    gc.disable()
    try:
        assert len(list(video.frames())) == 40
        held = [each for each in gc.get_objects() if isinstance(each, av.VideoFrame)]
    finally:
        gc.enable()
    assert len(held) < 10


@pytest.mark.parametrize('name', [b'2024-05-01T12:30:05.mp4', b'na\xefve.mp4', b'http:a.mp4'])
def test_a_video_of_any_name(tmp_path: Path, name: bytes) -> None:
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b'/' + name))
    write_video(tmp_path / 'plain.mp4', [0, 33]).rename(path)
    assert len(list(open_source(str(path)).frames())) == 2


@pytest.mark.parametrize('first', [0, 1])
def test_a_video_that_begins_between_key_frames_says_so(tmp_path: Path, first: int) -> None:
    """As a recording of a stream does."""
    path = tmp_path / 'a.mkv'
    with coded(path, 'libx264', map(image, range(12)), gop=5, tune='zerolatency') as made:
        del made[:first]
        lost = next(n for n, packet in enumerate(made) if packet.is_keyframe)
    video = VideoFile(path)
    assert len(list(video.frames())) == 12 - first - lost
    assert video.account.lost == lost
    assert [error.split(' of the')[0] for error in video.account.errors] == [
        f'{lost} frames before the first key frame'
    ] * first


def test_a_frame_before_the_first_key_frame_counts_as_lost_once(tmp_path: Path) -> None:
    """Also of a codec whose decoder calls it an error."""
    path, options = tmp_path / 'a.mkv', {'deadline': 'realtime', 'lag-in-frames': '0'}
    with coded(path, 'libvpx-vp9', map(image, range(16)), **options) as made:
        del made[:3]
    video = VideoFile(path)
    assert [number_in(frame.image.pixels) for frame in video.frames()] == [*range(10, 16)]
    assert (video.account.kept, video.account.lost) == (6, 7)


@pytest.mark.parametrize('codec', ['libx264', 'libx265', 'mpeg2video', 'mpeg4'])
def test_no_false_image_is_shown_where_a_downlink_lost_a_part(tmp_path: Path, codec: str) -> None:
    path, lost, count = tmp_path / 'a.ts', 13, 26
    options = {'x265-params': 'bframes=0:keyint=10:log-level=none'} if codec == 'libx265' else {}
    randoms = map(np.random.default_rng, range(count))
    frames = [random.integers(0, 99, (120, 160, 3), np.uint8) for random in randoms]
    with coded(path, codec, frames, bf='0', b='2000000', **options) as made:
        keys = [n for n, packet in enumerate(made) if packet.is_keyframe]
    whole = {frame.stamp_ns: frame.image.pixels for frame in VideoFile(path).frames()}
    parts = [path.read_bytes()[at : at + 188] for at in range(0, path.stat().st_size, 188)]
    of_video = [at for at, part in enumerate(parts) if (part[1] & 0x1F) << 8 | part[2] == 0x100]
    starts = [at for at in of_video if parts[at][1] & 0x40]
    del parts[starts[lost] + 2]
    path.write_bytes(b''.join(parts))
    source = VideoFile(path)
    shown = {frame.stamp_ns: frame.image.pixels for frame in source.frames()}
    resumed = next(key for key in keys if key > lost)
    numbers = (*range(lost), *range(resumed, count))
    assert [*shown] == [50_000_000 * n or FIRST for n in numbers]
    assert all(np.array_equal(pixels, whole[stamp_ns]) for stamp_ns, pixels in shown.items())
    assert source.account.kept + source.account.lost == count
    assert source.account.errors[0] == 'parts of 1 packet of the video are missing'


@pytest.mark.parametrize('suffix', ['.avi', '.mp4', '.mkv'])
@pytest.mark.parametrize('b_frames', ['0', '3'])
def test_frames_that_refer_to_later_ones_have_their_own_times(
    tmp_path: Path, suffix: str, b_frames: str
) -> None:
    """Of AVI FFmpeg says the order of decoding."""
    times = [n for n in range(20) if n not in (7, 8, 13)]
    path = tmp_path / f'a{suffix}'
    with coded(path, 'libx264', map(image, times), times=times, bf=b_frames):
        pass
    frames = list(VideoFile(path).frames())
    assert [number_in(frame.image.pixels) for frame in frames] == times
    assert [frame.stamp_ns for frame in frames] == [50_000_000 * time or FIRST for time in times]


@pytest.mark.parametrize('suffix', ['.mp4', '.mkv'])
@pytest.mark.parametrize(
    ('codec', 'options'),
    [
        ('libx264', {'x264-params': 'scenecut=0:bframes=0'}),
        ('libx265', {'x265-params': 'scenecut=0:bframes=0:keyint=10:log-level=none'}),
    ],
)
def test_no_false_image_is_shown_where_packets_are_missing(
    tmp_path: Path, suffix: str, codec: str, options: dict[str, str]
) -> None:
    """As they are in what was saved of a stream over a bad link."""
    path = tmp_path / f'a{suffix}'
    with coded(path, codec, map(image, range(24)), **options) as made:
        del made[13]
    video = VideoFile(path)
    shown = [number_in(frame.image.pixels) for frame in video.frames()]
    assert shown == [*range(13), *range(20, 24)]
    assert (video.account.kept, video.account.lost) == (17, 6)
    assert '6 frames not read, as others that they need are missing' in video.account.errors


def test_no_false_image_is_shown_behind_a_packet_that_does_not_decode(tmp_path: Path) -> None:
    path = tmp_path / 'a.mkv'
    options = {'sc_threshold': '1000000000', 'qmax': '2'}
    with coded(path, 'mpeg4', map(image, range(24)), **options) as made:
        whole, made[13] = made[13], av.Packet(bytes(made[13])[:8] + bytes(30))
        for name in ('stream', 'pts', 'dts', 'time_base'):
            setattr(made[13], name, getattr(whole, name))
    video = VideoFile(path)
    shown = [number_in(frame.image.pixels) for frame in video.frames()]
    assert shown == [*range(13), *range(20, 24)]
    assert (video.account.kept, video.account.lost) == (17, 7)


def test_a_tiff_of_several_images_is_not_taken_for_one_in_silence(tmp_path: Path) -> None:
    image = np.full((HEIGHT, WIDTH), 9, np.uint8)
    cv2.imwrite(str(tmp_path / '1.tiff'), image)
    cv2.imwritemulti(str(tmp_path / '2.tiff'), [image] * 3)
    source = open_source(str(tmp_path))
    assert [frame.image.width for frame in source.frames()] == [WIDTH] * 2
    assert source.account.errors == ['2.tiff: only the first of its 3 images is read']
    assert (source.account.kept, source.account.lost) == (2, 2)

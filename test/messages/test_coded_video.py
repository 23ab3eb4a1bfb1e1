"""A topic of video packets, some of which are nothing."""

import numpy as np
import pytest
from support.coded_videos import number_in, packets

from mvuav_ros.messages.images import BadFrame, CodedImage, Frame, VideoDecoder


def decoded(parts):
    video = VideoDecoder(low_delay=True)
    return [
        frame
        for stamp, data in enumerate(parts)
        for frame in video.frames(CodedImage(stamp, 'nose', 'h264', data, True), True)
    ]


@pytest.mark.parametrize('at', [0, 3, 8])
def test_an_empty_packet_is_one_bad_frame_and_not_the_end_of_the_video(at):
    parts = [np.frombuffer(packet, np.uint8) for packet in packets('libx264', 8)]
    parts.insert(at, np.empty(0, np.uint8))
    frames = decoded(parts)
    bad = [frame.stamp_ns for frame in frames if isinstance(frame, BadFrame)]
    good = [number_in(frame.image.pixels) for frame in frames if isinstance(frame, Frame)]
    assert bad == [at]
    assert good == list(range(8))


def test_no_false_image_is_made_of_what_follows_a_lost_packet():
    """A bag does not say that there was one; the next key frame is the sixth."""
    video, frames = VideoDecoder(), []
    for stamp, data in enumerate(packets('libx264', 12)):
        if stamp != 2:
            frames += video.frames(CodedImage(stamp, 'nose', 'h264', data, True), True)
    frames += video.end()
    good = {f.stamp_ns: number_in(f.image.pixels) for f in frames if isinstance(f, Frame)}
    assert good == {stamp: stamp for stamp in (0, 1, *range(5, 12))}
    assert [f.stamp_ns for f in frames if isinstance(f, BadFrame)] == [3, 4]


def test_live_frames_behind_a_lost_packet_are_unusable_by_the_next_key_frame():
    """They give neither an image nor an error, and were told 32 packets later."""
    sent = packets('libx264', 20, options={'x264-params': 'keyint=12:bframes=0:scenecut=0'})
    frames = decoded([*sent[:4], *sent[5:20]])
    bad = [isinstance(frame, BadFrame) for frame in frames]
    assert bad == [False] * 4 + [True] * 7 + [False] * 8


@pytest.mark.parametrize(
    ('encoder', 'codec', 'options'),
    [
        ('libx264', 'h264', {}),
        ('libx265', 'hevc', {'x265-params': 'keyint=5:bframes=0:log-level=none'}),
        ('libvpx-vp9', 'vp9', {'lag-in-frames': '0'}),
    ],
)
def test_no_false_image_is_made_of_a_packet_that_is_cut_nor_of_what_follows(
    encoder, codec, options
):
    """The next key frame is the eleventh."""
    video, frames = VideoDecoder(low_delay=True), []
    for stamp, data in enumerate(packets(encoder, 14, options=options)):
        data = data[: len(data) // 2] if stamp == 7 else data
        frames += video.frames(CodedImage(stamp, 'nose', codec, data, True), True)
    frames += video.end()
    good = {f.stamp_ns: number_in(f.image.pixels) for f in frames if isinstance(f, Frame)}
    assert good == {stamp: stamp for stamp in (*range(7), *range(10, 14))}
    assert sorted(f.stamp_ns for f in frames if isinstance(f, BadFrame)) == [7, 8, 9]


def test_behind_a_lost_packet_a_video_goes_on_whose_parameters_came_only_once():
    """As some encoders send them: in front of the first key frame."""
    video, frames = VideoDecoder(), []
    for stamp, data in enumerate(packets('libx264', 12)):
        if stamp == 5:
            key = data.rindex(b'\0\0\1\x65')
            data = data[key:]
        if stamp != 2:
            frames += video.frames(CodedImage(stamp, 'nose', 'h264', data, True), True)
    frames += video.end()
    good = {f.stamp_ns: number_in(f.image.pixels) for f in frames if isinstance(f, Frame)}
    assert good == {stamp: stamp for stamp in (0, 1, *range(5, 12))}


def test_no_false_image_is_made_of_a_last_packet_that_is_cut():
    """Of a decoder that holds frames back, as with frames that refer to later ones."""
    video, frames = VideoDecoder(), []
    coded = packets('libx264', 12, b_frames=2, options={'tune': 'psnr', 'x264-params': 'bframes=2'})
    for stamp, data in enumerate(coded):
        data = data[: len(data) // 2] if stamp == 11 else data
        frames += video.frames(CodedImage(stamp, 'nose', 'h264', data, True), True)
    frames += video.end()
    whole = VideoDecoder()
    packed = [CodedImage(stamp, 'nose', 'h264', data, True) for stamp, data in enumerate(coded)]
    right = [frame for each in packed for frame in whole.frames(each, True)] + [*whole.end()]
    truth = {frame.stamp_ns: frame.image.pixels for frame in right}
    good = [frame for frame in frames if isinstance(frame, Frame)]
    assert len(frames) == 12 and len(good) >= 9
    assert all(np.array_equal(frame.image.pixels, truth[frame.stamp_ns]) for frame in good)

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

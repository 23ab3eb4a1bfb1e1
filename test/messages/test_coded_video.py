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

"""A checkerboard before the camera of a flight, as a video of 11 s.

    python tools/render_board_video.py FLIGHT OUT.mp4

FLIGHT is a recording with its calibration.
"""

import sys
from pathlib import Path

import av

from mvuav_ros.sources.opening import open_source

sys.path.append(str(Path(__file__).resolve().parent.parent / 'test'))
from support.board_video import BoardVideo

if len(sys.argv) != 3:
    sys.exit('usage: python tools/render_board_video.py FLIGHT OUT.mp4')
lens = next(open_source(sys.argv[1]).frames()).camera
video = BoardVideo(seed=1, places=20, lens=lens)
with av.open(sys.argv[2], 'w') as container:
    stream = container.add_stream('libx264', rate=15, options={'crf': '14', 'preset': 'veryfast'})
    stream.width, stream.height, stream.pix_fmt = lens.width, lens.height, 'yuv420p'
    for image in video.images():
        for packet in stream.encode(av.VideoFrame.from_ndarray(image, format='gray')):
            container.mux(packet)
    for packet in stream.encode():
        container.mux(packet)
k = lens.k
print(f'true focal length {k[0]:.1f} {k[4]:.1f}, principal point {k[2]:.1f} {k[5]:.1f} px')

"""A video of a moving checkerboard: python examples/render_a_board_video.py OUT.mp4 [SEED]."""

import sys

import av

from mvuav_ros.simulation.board import BoardVideo

if len(sys.argv) < 2:
    sys.exit('usage: python examples/render_a_board_video.py OUT.mp4 [SEED]')
video = BoardVideo(seed=int(sys.argv[2]) if len(sys.argv) > 2 else 1, places=24)
with av.open(sys.argv[1], 'w') as container:
    stream = container.add_stream('libx264', rate=15, options={'crf': '14', 'preset': 'veryfast'})
    (stream.width, stream.height), stream.pix_fmt = video.size, 'yuv420p'
    for image in video.images():
        for packet in stream.encode(av.VideoFrame.from_ndarray(image, format='gray')):
            container.mux(packet)
    for packet in stream.encode():
        container.mux(packet)
k = video.camera.k
print(f'true focal length {k[0]:.1f} {k[4]:.1f}, principal point {k[2]:.1f} {k[5]:.1f} px')

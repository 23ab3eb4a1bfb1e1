"""Track the markers of a whole recording: python examples/replay_a_bag.py BAG."""

import sys

from mvuav_ros import MarkerTracker
from mvuav_ros.messages.images import BadFrame
from mvuav_ros.sources.opening import open_source

if len(sys.argv) != 2:
    sys.exit('usage: python examples/replay_a_bag.py BAG')
tracker = MarkerTracker()
for frame in open_source(sys.argv[1]).frames():
    if isinstance(frame, BadFrame):
        print(f'{frame.stamp_ns * 1e-9:.3f} s: {frame.reason}')
        continue
    result = tracker.process(frame.image, frame.stamp_ns)
    seen = sum(marker.state.name == 'DETECTED' for marker in result.markers)
    print(f'{frame.stamp_ns * 1e-9:.3f} s: {seen} of 5 markers, roll {result.roll:+.4f} rad')

"""Find the tanker's five lights in one image: python examples/detect_in_one_image.py IMAGE."""

import sys

import cv2

from mvuav_ros import Image, MarkerTracker
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters

if len(sys.argv) != 2:
    sys.exit('usage: python examples/detect_in_one_image.py IMAGE')
pixels = cv2.imread(sys.argv[1], cv2.IMREAD_GRAYSCALE)
if pixels is None:
    sys.exit(f'{sys.argv[1]} is no image')
tracker = MarkerTracker(MarkerTrackerParameters(mode='detect', threshold=0.6))
result = tracker.process(Image(pixels, 'mono8'), stamp_ns=0)
for name, marker in zip(tracker.rig.names, result.markers, strict=True):
    print(f'{name}: {marker.state.name.lower()} at x {marker.x:.2f} px, y {marker.y:.2f} px')
print(f'roll {result.roll:.4f} rad {result.status}')

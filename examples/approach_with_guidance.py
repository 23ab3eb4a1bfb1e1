"""Lateral offset and height before a runway: python examples/approach_with_guidance.py."""

from mvuav_ros import ApproachDetector, CameraModel
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.sources.opening import open_source

detector = ApproachDetector(RunwayDetectorParameters(mode='approach', runway_width=30.0))
for frame in open_source('sim:runway?frames=40&width=320&height=240').frames():
    if isinstance(frame.camera, CameraModel):
        detector.set_camera(frame.camera)
    result = detector.process(frame.image.bgr(), frame.stamp_ns)
    if result.guidance is not None:
        guidance = result.guidance
        print(f'offset {guidance.y:.1f} m, height {guidance.z:.1f} m', end=', ')
    print(f'confidence {result.confidence:.2f} {result.status}')

"""Calibrations beside the images of `recording_samples`."""

from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.sensors import CAMERA_INFO, encode_camera_info
from mvuav_ros.vision.camera import CameraModel
from support.recording_samples import START_NS, STEP_NS, Sample


def calibration_sample(
    number: int, focal_length: float, size: tuple[int, int] = (64, 48)
) -> Sample:
    """The CameraInfo of image ``number``, by our writer, which is held against rclpy's."""
    (width, height), stamp_ns = size, START_NS + number * STEP_NS
    k = (focal_length, 0, width / 2, 0, focal_length, height / 2, 0, 0, 1)
    camera, header = CameraModel(width, height, k), cdr_header(stamp_ns, f'camera {number}')
    return Sample('/camera/camera_info', CAMERA_INFO, stamp_ns, encode_camera_info(camera, header))

"""A source's frames as ``image_raw``, ``image_raw/compressed`` and ``camera_info``."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, CompressedImage
from sensor_msgs.msg import Image as RosImage
from std_msgs.msg import Header

from mvuav_ros.nodes.result_publishers import create_result_publisher, is_heard
from mvuav_ros.parameters.video_source import VideoSourceParameters
from mvuav_ros.processing.messages.sensors import encode_camera_info, make_header
from mvuav_ros.recordings.serialization.cdr import cdr_header
from mvuav_ros.recordings.serialization.messages import decode_camera_info
from mvuav_ros.recordings.serialization.serialized_image import (
    serialize_compressed_image,
    serialize_image,
)
from mvuav_ros.recordings.sources.frame import Frame
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image

Listener = Callable[[Frame], None]


class FramePublisher:
    """Publishes frames where somebody listens, and hands them to detectors of this process."""

    def __init__(
        self, node: Node, calibration: CameraModel | None, listeners: Sequence[Listener]
    ) -> None:
        """Make the topics; without a calibration frames keep their own, if they have one."""
        self._node = node
        self._calibration = calibration
        self._listeners = listeners
        # Before the images, so that whoever sees those has seen these.
        self._infos = create_result_publisher(node, CameraInfo, 'camera_info')
        self._images = create_result_publisher(node, RosImage, 'image_raw')
        # Resolved first, so that a remapping of image_raw moves the compressed topic along.
        compressed = node.resolve_topic_name('image_raw') + '/compressed'
        self._compressed = create_result_publisher(node, CompressedImage, compressed)

    @property
    def subscribers(self) -> int:
        """Subscriptions of the images in other processes."""
        return sum(int(p.get_subscription_count()) for p in (self._images, self._compressed))

    def destroy(self) -> None:
        """Take the topics off the graph."""
        for publisher in (self._infos, self._images, self._compressed):
            self._node.destroy_publisher(publisher)

    def publish(self, frame: Frame, given: VideoSourceParameters) -> Image:
        """Send a frame as the parameters have it; returns the image that was sent.

        Raises:
            ImageError: it cannot be converted.
        """
        image = as_encoding(frame.image, given.encoding).gamma_corrected(given.gamma)
        stamp_ns = frame.stamp_ns
        if given.stamp == 'now':
            stamp_ns = self._node.get_clock().now().nanoseconds
        frame_id = given.frame_id or frame.frame_id
        # First, so that no image has to wait for it.
        self._publish_info(frame, image, stamp_ns, frame_id)
        header = cdr_header(stamp_ns, frame_id)
        if is_heard(self._images):
            self._images.publish(serialize_image(image, header))
        if is_heard(self._compressed):
            self._compressed.publish(_jpeg(image, header, given.jpeg_quality))
        return image

    def _publish_info(self, frame: Frame, image: Image, stamp_ns: int, frame_id: str) -> None:
        heard = is_heard(self._infos)
        if not heard and not self._listeners:
            return
        info = self._camera_info(frame, image, make_header(stamp_ns, frame_id))
        for listener in self._listeners:
            camera = decode_camera_info(info, str(self._images.topic_name))
            listener(Frame(stamp_ns, frame_id, image, camera))
        if heard:
            self._infos.publish(info)

    def _camera_info(self, frame: Frame, image: Image, header: Header) -> CameraInfo:
        """All-zero matrices say that the camera is not calibrated."""
        camera = self._calibration or frame.camera
        if camera is not None:
            return encode_camera_info(camera, header)
        return CameraInfo(header=header, width=image.width, height=image.height)


def as_encoding(image: Image, encoding: str) -> Image:
    """The image in another encoding; ``source`` leaves it as it is."""
    if encoding in ('source', image.encoding):
        return image
    if encoding == 'mono8':
        gray = image.gray()
        return Image(gray if gray.dtype == 'uint8' else (gray >> 8).astype('uint8'), 'mono8')
    bgr = image.bgr()
    return Image(bgr if encoding == 'bgr8' else bgr[:, :, ::-1], encoding)


def _jpeg(image: Image, header: bytes, quality: int) -> bytes:
    gray = image.encoding in ('mono8', '8UC1')
    pixels = image.pixels if gray else image.bgr()
    _, data = cv2.imencode('.jpg', pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return serialize_compressed_image('jpeg', data.tobytes(), header)

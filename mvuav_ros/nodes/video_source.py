"""``video_source``: cameras, videos, image folders and bags as ``image_raw``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from std_srvs.srv import SetBool, Trigger

from mvuav_ros.nodes.frame_publishing import FramePublisher, Listener
from mvuav_ros.nodes.live_parameters import LiveParameters
from mvuav_ros.nodes.managed_node import ManagedNode
from mvuav_ros.nodes.running import run_node
from mvuav_ros.nodes.source_player import SourcePlayer
from mvuav_ros.nodes.source_status import SourceStatus
from mvuav_ros.parameters.video_source import VideoSourceParameters
from mvuav_ros.recordings.sources.calibration import load_calibration
from mvuav_ros.recordings.sources.camera import CameraSettings
from mvuav_ros.recordings.sources.frame import Frame, FrameSource
from mvuav_ros.recordings.sources.opening import open_source
from mvuav_ros.vision.image import Image


class VideoSource(ManagedNode):
    """Publishes a source's frames from a thread of its own, so that services stay responsive."""

    def __init__(
        self,
        listeners: Sequence[Listener] = (),
        count_listening: Callable[[], int] = lambda: 0,
    ) -> None:
        """Make the node; it plays once it is configured and activated.

        Args:
            listeners: of this process, called with each frame as it is published.
            count_listening: how many of them answer now.
        """
        super().__init__('video_source')
        self._listeners = listeners
        self._count_listening = count_listening
        self._live = LiveParameters(self, VideoSourceParameters, lambda _: None)
        self._publisher: FramePublisher | None = None
        self._source: FrameSource | None = None
        self._player: SourcePlayer | None = None
        self._status = SourceStatus(self._live.current.source)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self.create_timer(1.0, self._once_a_second, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.create_service(SetBool, '~/pause', self._on_pause)
        self.create_service(Trigger, '~/restart', self._on_restart)

    @property
    def failed(self) -> bool:
        """Whether the source broke in a way that nothing here is made for."""
        return self._player is not None and self._player.failed

    def open(self) -> None:
        """Open the source, the calibration and the topics; a camera is only named."""
        given = self._live.current
        self._source = self._open_source()
        calibration = load_calibration(given.camera_info_url) if given.camera_info_url else None
        self._publisher = FramePublisher(self, calibration, self._listeners)

    def _open_source(self) -> FrameSource:
        given = self._live.current
        camera = CameraSettings(
            width=given.width,
            height=given.height,
            fps=given.fps,
            pixel_format=given.pixel_format,
            exposure_time_absolute=given.exposure_time_absolute,
            gain=given.gain,
        )
        return open_source(given.source, topic=given.bag_topic or None, camera=camera)

    def begin(self) -> None:
        """Take the camera, or play the recording from its start."""
        assert self._publisher is not None
        source, self._source = self._source or self._open_source(), None
        self._status.source = source.name
        self._player = SourcePlayer(
            self,
            source,
            self._status,
            lambda: self._live.current,
            self._publish,
            lambda: self._subscribers,
        )
        self._status.state = 'waiting'
        self.get_logger().info(
            f'publishing {source.name} on {self.resolve_topic_name("image_raw")}'
        )
        self._player.start()

    def end(self) -> None:
        """Let go of the camera or the file."""
        if self._player is not None:
            self._player.stop()
            self._player = None

    def close(self) -> None:
        """Take the topics off the graph."""
        if self._source is not None:
            self._source.close()
            self._source = None
        if self._publisher is not None:
            self._publisher.destroy()
            self._publisher = None

    def _publish(self, frame: Frame) -> Image:
        assert self._publisher is not None
        return self._publisher.publish(frame, self._live.current)

    @property
    def _subscribers(self) -> int:
        others = 0 if self._publisher is None else self._publisher.subscribers
        return others + self._count_listening()

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        player = self._player
        if player is None:
            response.message = f'the node is {self.lifecycle_state}, not active'
            return response
        if request.data:
            player.pause()
        else:
            player.resume()
        response.success, response.message = True, 'paused' if request.data else 'playing'
        return response

    def _on_restart(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        player = self._player
        if player is None:
            response.message = f'the node is {self.lifecycle_state}, not active'
            return response
        player.restart()
        response.success, response.message = True, f'playing {self._status.source} from the start'
        return response

    def _once_a_second(self) -> None:
        player = self._player
        if player is None:
            self._status.state = self.lifecycle_state
        message = DiagnosticArray()
        message.header.stamp = self.get_clock().now().to_msg()
        paused = player is not None and player.paused
        name = self.get_fully_qualified_name()
        message.status.append(self._status.report(name, paused, self._subscribers))
        self._diagnostics.publish(message)


def main() -> None:
    """Run the node."""
    sys.exit(run_node(VideoSource, camera_images=True))

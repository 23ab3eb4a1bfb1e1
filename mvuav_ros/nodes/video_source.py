"""``video_source``: cameras, videos, image folders and bags as ``image_raw``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import TypeVar

from diagnostic_msgs.msg import DiagnosticStatus
from std_srvs.srv import SetBool, Trigger

from mvuav_ros.nodes.diagnostics import SourceStatus, publish_status
from mvuav_ros.nodes.frame_publishing import FramePublisher, Listener
from mvuav_ros.nodes.live_parameters import LiveParameters
from mvuav_ros.nodes.managed_node import ManagedNode
from mvuav_ros.nodes.running import run_nodes
from mvuav_ros.nodes.source_player import SourcePlayer
from mvuav_ros.parameters.video_source import VideoSourceParameters
from mvuav_ros.recordings.sources.calibration import load_calibration
from mvuav_ros.recordings.sources.camera import CameraSettings
from mvuav_ros.recordings.sources.frame import Frame, FrameSource
from mvuav_ros.recordings.sources.opening import open_source
from mvuav_ros.vision.image import Image

ResponseT = TypeVar('ResponseT', SetBool.Response, Trigger.Response)


class VideoSource(ManagedNode):
    """Publishes a source's frames from a thread of its own, so that services stay responsive."""

    def __init__(
        self,
        listeners: Sequence[Listener] = (),
        count_listening: Callable[[], int] = lambda: 0,
    ) -> None:
        """Make the node; it plays once it is configured and activated.

        ``listeners`` of this process are called with each frame as it is published;
        ``count_listening`` says how many of them answer now.
        """
        super().__init__('video_source')
        self._listeners = listeners
        self._count_listening = count_listening
        self._live = LiveParameters(self, VideoSourceParameters, lambda _: None)
        self._publisher: FramePublisher | None = None
        self._source: FrameSource | None = None
        self._player: SourcePlayer | None = None
        self._status = SourceStatus(self._live.current.source)
        publish_status(self, self._report)
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
        camera = CameraSettings(**{f.name: getattr(given, f.name) for f in fields(CameraSettings)})
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
        action = SourcePlayer.pause if request.data else SourcePlayer.resume
        return self._ask(action, response, 'paused' if request.data else 'playing')

    def _on_restart(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        said = f'playing {self._status.source} from the start'
        return self._ask(SourcePlayer.restart, response, said)

    def _ask(
        self, action: Callable[[SourcePlayer], None], response: ResponseT, said: str
    ) -> ResponseT:
        if self._player is None:
            response.message = f'the node is {self.lifecycle_state}, not active'
        else:
            action(self._player)
            response.success, response.message = True, said
        return response

    def _report(self) -> DiagnosticStatus:
        player = self._player
        if player is None:
            self._status.state = self.lifecycle_state
        paused = player is not None and player.paused
        return self._status.report(self.get_fully_qualified_name(), paused, self._subscribers)


def main() -> None:
    """Run the node."""
    sys.exit(run_nodes(lambda: [VideoSource()], camera_images=True))

"""What a detector tells ``/diagnostics``."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus

from mvuav_ros.nodes.diagnostics import status
from mvuav_ros.nodes.frame_answering import FrameAnswerer
from mvuav_ros.nodes.frame_statistics import WINDOW
from mvuav_ros.nodes.input_monitor import InputMonitor, explain_no_images
from mvuav_ros.nodes.received_image import InputState
from mvuav_ros.processing.processor import Processor


class DetectorStatus:
    """Turns counts into a diagnostic status, once a second while the node is active."""

    def __init__(self, answerer: FrameAnswerer, processor: Processor) -> None:
        self._answerer = answerer
        self._processor = processor
        self._monitor = InputMonitor()

    @property
    def state(self) -> str:
        """``running`` or ``disabled``."""
        return 'running' if self._answerer.enabled else 'disabled'

    def report(self, name: str, images: InputState) -> DiagnosticStatus:
        """The status of the last seconds; `FrameAnswerer.lock` is held by the caller."""
        problems = self._monitor.problems(images.events, self._answerer.stamps)
        level = DiagnosticStatus.OK
        statistics = self._answerer.statistics
        if self._answerer.enabled and statistics.silent:
            never = statistics.received == 0
            level = DiagnosticStatus.STALE if never else DiagnosticStatus.WARN
            since = '' if never else f' for {WINDOW:.0f} s'
            problems = [f'no images{since}: {explain_no_images(images)}']
        elif self._answerer.enabled:
            problems += self._active_problems(images)
        if problems and level == DiagnosticStatus.OK:
            level = DiagnosticStatus.WARN
        return status(level, name, '; '.join(problems) or self.state, self._values(images))

    def _active_problems(self, images: InputState) -> list[str]:
        count = len(images.publishers)
        mixed = f'{count} publishers on {images.topic}: their images are mixed' if count > 1 else ''
        said = [*self._answerer.statistics.problems(), mixed, self._processor.status]
        return [words for words in said if words]

    def _values(self, images: InputState) -> dict[str, str]:
        events, stamps = images.events, self._answerer.stamps
        spacing = stamps.spacing_ns
        return {
            'state': self.state,
            **self._answerer.statistics.values(),
            'frames_skipped': str(events.skipped),
            'frames_lost_in_transport': str(events.lost),
            'frames_missing': str(events.missing),
            'frames_left_out_by_stamps': str(stamps.frames_left_out),
            'stamp_rate_hz': f'{1e9 / spacing:.1f}' if spacing else 'nan',
            'stamp_jumps_back': str(self._processor.resets),
            'stamp_jumps_forward': str(stamps.jumps_forward),
            'image': self._answerer.image_format,
            'image_topic': images.topic,
            'calibration': self._processor.calibration,
            'image_publishers': ' '.join(images.publishers),
            'incompatible_publishers': str(events.incompatible),
        }

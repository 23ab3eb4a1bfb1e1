"""What is wrong with the images that reach a node, and what to do about it."""

from __future__ import annotations

import statistics
from collections import deque

from mvuav_ros.nodes.frame_statistics import WINDOW
from mvuav_ros.nodes.received_image import InputEvents, InputState

LOST_REMEDY = (
    "give the camera's process a larger shared-memory segment, or let it publish reliably "
    'and subscribe reliably (docs/transport.md)'
)
SLOW_REMEDY = 'lower the frame rate or the image size'
_STAMPS = 32
_GAP = 1.6
"""Times the usual spacing of stamps, from which on a frame is missing in between."""


class StampMonitor:
    """Follows the stamps of images: their spacing, and gaps in it."""

    def __init__(self) -> None:
        self._spacings: deque[int] = deque(maxlen=_STAMPS)
        self._last_ns: int | None = None
        self.frames_left_out = 0
        self.jumps_forward = 0

    def follow(self, stamp_ns: int) -> None:
        """Take the next frame's stamp."""
        last, self._last_ns = self._last_ns, stamp_ns
        if last is None or stamp_ns <= last:
            return
        spacing = stamp_ns - last
        usual = self.spacing_ns
        if usual and spacing > WINDOW * 1e9:
            # A pause of the recording or another clock: no frames are missing there.
            self.jumps_forward += 1
            return
        if usual and spacing > _GAP * usual:
            self.frames_left_out += round(spacing / usual) - 1
        self._spacings.append(spacing)

    @property
    def spacing_ns(self) -> int:
        """The usual time between two stamps; 0 while too few have come."""
        return round(statistics.median(self._spacings)) if len(self._spacings) >= 8 else 0


class InputMonitor:
    """Turns counters into sentences: what happened in the last seconds, and the remedy."""

    def __init__(self) -> None:
        self._history: deque[dict[str, int]] = deque(maxlen=round(WINDOW) + 1)

    def problems(self, events: InputEvents, stamps: StampMonitor) -> list[str]:
        """Sentences about the last seconds; to be called once a second."""
        counts = {
            'lost': events.lost,
            'missing': events.missing,
            'skipped': events.skipped,
            'errors': events.errors,
            'left out': stamps.frames_left_out,
        }
        self._history.append(counts)
        recent = {name: count - self._history[0][name] for name, count in counts.items()}
        problems = []
        skipped = max(recent['missing'] - recent['lost'], 0) + recent['skipped']
        if recent['lost']:
            problems.append(f'{recent["lost"]} images lost in transport: {LOST_REMEDY}')
        if skipped:
            problems.append(f'too slow for the camera: {skipped} images skipped; {SLOW_REMEDY}')
        elif recent['left out'] and not recent['lost']:
            problems.append(
                f'gaps in the stamps: {recent["left out"]} images are missing, although no message '
                'was lost; the camera, its driver or the recording dropped them'
            )
        if recent['errors']:
            problems.append(f'images could not be received: {events.last_error}')
        return problems


def explain_no_images(images: InputState) -> str:
    """Why no images come at all."""
    topic, publishers, events = images
    if not publishers:
        return f'nothing publishes {topic}'
    said = f'{", ".join(publishers)} publishes {topic}'
    if events.incompatible:
        policy = events.incompatible_policy
        return f'{said} with an incompatible QoS ({policy}); set qos_overrides'
    if events.lost:
        return f'{said}, but every image is lost: {LOST_REMEDY}'
    return f'{said}, but no image arrives (docs/transport.md)'

"""Processors over a whole source, without a ROS graph and as fast as the machine goes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from mvuav_ros.processing.processor import DuplicateStampError, Output, Processor
from mvuav_ros.recordings.serialization.cdr import cdr_header
from mvuav_ros.recordings.serialization.type_name import type_name
from mvuav_ros.recordings.sources.frame import BadFrame, Frame
from mvuav_ros.vision.image import ImageError

_MOST_REASONS = 100


@dataclass
class ReplayCounts:
    """What became of the frames.

    Attributes:
        frames: read from the source, unusable ones included.
        answered: processed by every node.
        refused: number of frames without a result, by reason.
    """

    frames: int = 0
    answered: int = 0
    refused: Counter[str] = field(default_factory=Counter)

    def refuse(self, reason: str) -> None:
        """Count a frame without a result; very many different reasons are counted as one."""
        if reason not in self.refused and len(self.refused) >= _MOST_REASONS:
            reason = 'other reasons'
        self.refused[reason] += 1


Write = Callable[[str, str, int, bytes], None]
"""Takes topic, type, stamp (ns) and CDR bytes of one result."""


def replay(
    frames: Iterable[Frame | BadFrame],
    processors: Sequence[Processor],
    write: Write,
    *,
    debug: bool = False,
) -> Iterator[ReplayCounts]:
    """Process every frame and write every result under its fully qualified topic.

    Args:
        frames: what a source yields.
        processors: the nodes, each with a name of its own.
        write: called with each result.
        debug: also make the debug images.

    Yields:
        The counts so far, the same object after each frame.
    """
    counts = ReplayCounts()
    last: Frame | None = None
    for frame in frames:
        counts.frames += 1
        if isinstance(frame, BadFrame):
            counts.refuse(frame.reason)
        else:
            last = frame
            reasons = _process(frame, processors, write, debug)
            for reason in reasons:
                counts.refuse(reason)
            counts.answered += not reasons
        yield counts
    if last is not None:
        header = cdr_header(last.stamp_ns, last.frame_id)
        for processor in processors:
            _write(processor, processor.periodic(header), last.stamp_ns, write)


def _process(frame: Frame, processors: Sequence[Processor], write: Write, debug: bool) -> list[str]:
    """Each node's results, whether or not another node can use the frame; why one cannot."""
    reasons = []
    for processor in processors:
        try:
            outputs = processor.process(frame, processor.debug_topics if debug else ())
        except DuplicateStampError:
            reasons.append('the stamp of the frame before')
        except ImageError as error:
            reasons.append(str(error))
        except Exception as error:
            # As in a live node, a defect of ours costs a frame and not the flight.
            reasons.append(f'internal error of {processor.name}: {type(error).__name__}: {error}')
        else:
            _write(processor, outputs, frame.stamp_ns, write)
    return list(dict.fromkeys(reasons))


def _write(processor: Processor, outputs: list[Output], stamp_ns: int, write: Write) -> None:
    for topic, make in outputs:
        kind = type_name(processor.type_of(topic))
        write(f'/{processor.name}/{topic}', kind, stamp_ns, make())

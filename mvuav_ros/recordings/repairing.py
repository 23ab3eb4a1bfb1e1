"""Everything that can be read of a recording as a sound one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from mvuav_ros.recordings.errors import RecordingError
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.rosbag2_folder import open_writer

_PROGRESS_STEP = 100


@dataclass
class RepairReport:
    """What a repair wrote and what it could not read.

    Attributes:
        messages: number written, by topic.
        skipped: topics whose messages are not ROS's, with their encodings.
        errors: what could not be read, in words.
        warnings: what is unusual without a loss.
    """

    messages: dict[str, int] = field(default_factory=dict)
    skipped: dict[str, str] = field(default_factory=dict)
    errors: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def repair(
    source: Path,
    output: Path,
    *,
    overwrite: bool = False,
    split_bytes: int | None = None,
    progress: Callable[[int, int | None], None] = lambda *_: None,
) -> RepairReport:
    """Copy every readable message, with its definition, QoS and log time.

    Args:
        source: the recording, in whatever condition.
        output: a file that ends in .mcap; with ``split_bytes``, a folder as rosbag2 makes it.
        overwrite: whether what exists may be replaced.
        split_bytes: the size at which the folder's next file begins; 0 never.
        progress: told now and then the number of messages, and of all as far as known.

    Raises:
        RecordingError: nothing can be read, or the output not be written.
    """
    target, own = output.resolve(), source.resolve()
    if target == own or target in own.parents or own in target.parents:
        raise RecordingError(f'{output} is in or around the input itself; give another output')
    report = RepairReport()
    with open_recording(source) as recording:
        counts = [topic.message_count for topic in recording.topics]
        total = None if None in counts else sum(count or 0 for count in counts)
        with open_writer(output, split_bytes, overwrite) as writer:
            for number, message in enumerate(recording.messages()):
                writer.copy(message)
                report.messages[message.topic] = report.messages.get(message.topic, 0) + 1
                if number % _PROGRESS_STEP == 0:
                    progress(number, total)
        report.skipped = dict(recording.skipped)
        report.errors, report.warnings = recording.errors, recording.warnings
    return report

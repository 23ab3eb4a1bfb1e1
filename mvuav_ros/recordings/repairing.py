"""Everything that can be read of a recording as a sound one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

from mvuav_ros.messages.untrusted import words
from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.layout import named_recording
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.rosbag2_folder import open_writer

_PROGRESS_STEP = 100


def repair(
    source: Path,
    output: Path,
    *,
    overwrite: bool = False,
    split_bytes: int | None = None,
    progress: Callable[[int, int | None], None] = lambda *_: None,
) -> Counter[str]:
    """Copy every readable message, with its definition, QoS, times and number.

    What could not be read, or not be copied as it is, goes to the recording's account.

    Args:
        source: the recording, in whatever condition.
        output: a file that ends in .mcap; with ``split_bytes``, a folder as rosbag2 makes it.
        overwrite: whether what exists may be replaced.
        split_bytes: the size at which the folder's next file begins; 0 never.
        progress: called now and then with the number of messages, and of all if known.

    Returns:
        The number of messages written, by topic.

    Raises:
        RecordingError: nothing can be read, or the output not be written.
    """
    target, own = output.resolve(), named_recording(source).resolve()
    if target == own or target in own.parents or own in target.parents:
        raise RecordingError(f'{output} is in or around the input itself; give another output')
    messages: Counter[str] = Counter()
    with open_recording(source) as recording:
        account = recording.account
        total = recording.message_count
        with open_writer(output, split_bytes, overwrite) as writer:
            for number, message in enumerate(recording.messages()):
                writer.write(*message)
                messages[message.topic] += 1
                if number % _PROGRESS_STEP == 0:
                    progress(number, total)
            writer.extras = recording.extras()
        for each in recording.skipped:
            said = f'{words(each.name)} is {words(each.encoding) or "without encoding"}, not CDR'
            account.lose('', each.name, f'skipped: {said}', 0)
    if account.skipped:
        account.lose('', 'skipped', f'{account.skipped} messages skipped', account.skipped)
    if writer.moved:
        account.alter('moved', f'{writer.moved} times before 1970 became 0', writer.moved)
    return messages

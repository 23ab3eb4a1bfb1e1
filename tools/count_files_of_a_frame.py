"""Through how many files of the package one calm frame goes in `mvuav replay`, and how often.

    python tools/count_files_of_a_frame.py [--files]

For `marker_tracker` over bags/tanker.mcap and `runway_detector` in mode approach over
bags/runway.mcap: the files whose functions run from the beginning of one frame's work to that of
the next, reading and writing included, and how often the file changes at a call or a return.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType
from typing import Any

from mvuav_ros.offline.replay.job import ReplayJob, ReplaySettings, attempt
from mvuav_ros.offline.stopping import Stop

ROOT = Path(__file__).resolve().parent.parent
CASES: dict[str, tuple[str, dict[str, dict[str, Any]]]] = {
    'marker_tracker': ('tanker', {'marker_tracker': {}}),
    'mode approach': ('runway', {'runway_detector': {'mode': 'approach'}}),
}
FRAME = 60
"""By then names and edges are known, and nothing new happens."""


class Profile:
    """Follows the calls of one frame, see `sys.setprofile`."""

    def __init__(self) -> None:
        self.files: dict[str, int] = {}
        self.changes = 0
        self._frames = 0
        self._last = ''

    def __call__(self, frame: FrameType, event: str, _argument: object) -> None:
        """Note a call, or a return to the caller's file."""
        if event not in ('call', 'return'):
            return
        code = frame.f_code
        if (
            event == 'call'
            and code.co_name == 'process'
            and code.co_filename.endswith('offline/replay/pipeline.py')
        ):
            self._frames += 1
        if self._frames != FRAME:
            return
        at = frame if event == 'call' else frame.f_back
        place = at.f_code.co_filename.partition('/mvuav_ros/')[2] if at is not None else ''
        # Others' files in between, such as NumPy's, are no change of ours.
        if place:
            if event == 'call':
                self.files[place] = self.files.get(place, 0) + 1
            self.changes += place != self._last
            self._last = place


def count(name: str) -> Profile:
    """Replay one of the `CASES` and follow its frame."""
    bag, parameters = CASES[name]
    profile = Profile()
    with TemporaryDirectory() as folder:
        job = ReplayJob(
            str(ROOT / 'bags' / f'{bag}.mcap'),
            str(Path(folder) / 'out.mcap'),
            ReplaySettings(parameters),
        )
        sys.setprofile(profile)
        outcome = attempt(job, lambda _: None, Stop())
        sys.setprofile(None)
    assert not outcome.failure, outcome.failure
    return profile


def main() -> None:
    """Print a line for each case."""
    parser = argparse.ArgumentParser()
    parser.add_argument('--files', action='store_true', help='which files, with their calls')
    options = parser.parse_args()
    for name in CASES:
        profile = count(name)
        calls = sum(profile.files.values())
        print(f'{name}: {len(profile.files)} files, {profile.changes} changes, {calls} calls')
        if options.files:
            for file, number in sorted(profile.files.items()):
                print(f'    {number:5d}  {file}')


if __name__ == '__main__':
    main()

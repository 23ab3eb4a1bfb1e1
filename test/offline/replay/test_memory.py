"""Memory does not grow with a recording's length."""

from __future__ import annotations

import os
import re
import subprocess
import time
from contextlib import suppress
from pathlib import Path

import pytest
from support.commands import COMMAND, ENVIRONMENT, ROOT, started, write_flight
from support.recording_samples import START_NS, Sample, write_mcap

# MVUAV_LONG_FLIGHT=60000 takes minutes.
LONG = int(os.environ.get('MVUAV_LONG_FLIGHT', '1800'))
SIZE = 160, 120


def peak_kib(*arguments: object, status: int = 0) -> int:
    """The most memory that the command and its processes ever had, each counted by itself.

    As far as a look every 10 ms can tell: what wait() reports is at least what the parent had
    when it forked.
    """
    peaks: dict[str, int] = {}
    with started(
        [*COMMAND, *map(str, arguments)], env=ENVIRONMENT, cwd=ROOT, stdout=subprocess.PIPE
    ) as process:
        while process.poll() is None:
            with suppress(OSError):
                children = Path(f'/proc/{process.pid}/task/{process.pid}/children').read_text()
                for number in (str(process.pid), *children.split()):
                    found = re.search(r'VmHWM:\s*(\d+)', Path(f'/proc/{number}/status').read_text())
                    peaks[number] = max(peaks.get(number, 0), int(found[1]) if found else 0)
            time.sleep(0.01)
    assert process.returncode == status
    return sum(peaks.values())


def test_of_huge_messages_that_are_no_images_few_are_held_at_a_time(tmp_path: Path) -> None:
    size = 150 << 20
    sample = Sample('/camera/image_raw', 'sensor_msgs/msg/Image', START_NS, bytes(size))
    bag = write_mcap(tmp_path / 'bag.mcap', [sample] * 3)
    one, two = (
        peak_kib('replay', bag, '-o', tmp_path / f'{n}.mcap', '--jobs', n, status=1) for n in (1, 2)
    )
    assert two < one + 3 * size / 1024


@pytest.mark.parametrize(
    'options', [pytest.param((), marks=pytest.mark.long), ('--keep-inputs', '--start', '0.5')]
)
def test_replay(tmp_path: Path, options: tuple[str, ...]) -> None:
    peaks = []
    for frames in (600, LONG):
        flight = write_flight(tmp_path / f'{frames}.mcap', frames, *SIZE)
        out = tmp_path / f'out{frames}.mcap'
        peaks.append(peak_kib('replay', flight, '-o', out, '--jobs', 1, *options))
    # All of the frames would be more than a fifth of what the program itself takes.
    assert LONG * SIZE[0] * SIZE[1] / 1024 > 0.2 * peaks[0]
    assert peaks[1] <= 1.2 * peaks[0]


def test_info(tmp_path: Path) -> None:
    flights = [write_flight(tmp_path / f'{n}.mcap', n, *SIZE) for n in (600, LONG)]
    short, long = (peak_kib('info', flight) for flight in flights)
    assert long <= 1.2 * short

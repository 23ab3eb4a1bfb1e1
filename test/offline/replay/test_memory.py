"""Memory does not grow with a recording's length."""

from __future__ import annotations

import os
import re
import subprocess
import time
from pathlib import Path

import pytest
from support.commands import COMMAND, ENVIRONMENT, ROOT, write_flight

# MVUAV_LONG_FLIGHT=60000 takes minutes.
LONG = int(os.environ.get('MVUAV_LONG_FLIGHT', '1800'))
SIZE = 160, 120


def peak_kib(*arguments: object) -> int:
    """The most memory that the command ever had, as far as a look every 10 ms can tell.

    What wait() reports is at least what the parent had when it forked.
    """
    peak = 0
    with subprocess.Popen(
        [*COMMAND, *map(str, arguments)], env=ENVIRONMENT, cwd=ROOT, stdout=subprocess.PIPE
    ) as process:
        while process.poll() is None:
            found = re.search(r'VmHWM:\s*(\d+)', Path(f'/proc/{process.pid}/status').read_text())
            peak = max(peak, int(found[1])) if found else peak
            time.sleep(0.01)
    assert process.returncode == 0
    return peak


@pytest.mark.parametrize(
    'options', [pytest.param((), marks=pytest.mark.long), ('--keep-inputs', '--start', '0.5')]
)
def test_replay(tmp_path: Path, options: tuple[str, ...]) -> None:
    peaks = []
    for frames in (600, LONG):
        flight = write_flight(tmp_path / f'{frames}.mcap', frames, *SIZE)
        out = tmp_path / f'out{frames}.mcap'
        peaks.append(peak_kib('replay', flight, '-o', out, *options))
    # All of the frames would be more than a fifth of what the program itself takes.
    assert LONG * SIZE[0] * SIZE[1] / 1024 > 0.2 * peaks[0]
    assert peaks[1] <= 1.2 * peaks[0]


def test_info(tmp_path: Path) -> None:
    flights = [write_flight(tmp_path / f'{n}.mcap', n, *SIZE) for n in (600, LONG)]
    short, long = (peak_kib('info', flight) for flight in flights)
    assert long <= 1.2 * short

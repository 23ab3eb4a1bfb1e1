"""The cases of `mvuav bench replay` run, and say where the time goes."""

from __future__ import annotations

import re

from mvuav_ros.cli.bench import replay
from mvuav_ros.cli.bench.case import measure


def test_cases_run() -> None:
    for case in replay.replay_cases(frames=45):
        measurement = measure(case, 0.01)
        assert measurement.median_ms > 0
        if case.limit_ms is not None:
            # 15 times real time of 30 frames/s.
            assert case.limit_ms == 100.0
            shares = [int(number) for number in re.findall(r'(\d+)%', case.note)]
            assert len(shares) == 3
            assert abs(sum(shares) - 100) <= 1
            assert all(share > 0 for share in shares)
        else:
            assert 2 / case.limit_ratio == 1.7

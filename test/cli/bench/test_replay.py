"""The cases of `mvuav bench replay` run, and have the limits that they are held against."""

from __future__ import annotations

import os

import pytest

from mvuav_ros.cli.bench.cases import measure, replay_cases


@pytest.mark.long
def test_cases_run() -> None:
    cases = replay_cases(frames=45)
    for case in cases:
        assert measure(case, 0.01).median_ms > 0
    # 15 times real time of 30 frames/s.
    assert [case.limit_ms for case in cases if case.limit_ms] == [100.0]
    beside = [case.baseline_name for case in cases if case.baseline]
    assert beside.count('read, decode, threshold') == 4
    assert beside.count('--jobs 1') == (2 if len(os.sched_getaffinity(0)) > 1 else 0)

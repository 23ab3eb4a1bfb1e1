"""What the benchmarks of the markers measure."""

import pytest

from mvuav_ros.cli.bench import cases


def test_detection_is_measured_without_the_making_of_a_tracker(monkeypatch: pytest.MonkeyPatch):
    case, *_ = cases._usual_cases()
    assert case.name.startswith('detect, 640x480')
    monkeypatch.setattr(cases, 'MarkerTracker', None)
    assert [len(case.run().markers) for _ in range(2)] == [5, 5]

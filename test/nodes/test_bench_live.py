"""``mvuav bench live`` on a real graph."""

from __future__ import annotations

from mvuav_ros.cli.bench.live import LiveCase, measure_live


def test_a_node_is_held_against_one_that_only_answers() -> None:
    (result,) = measure_live(LiveCase(('marker_tracker',)), 1.0)
    assert result.node == 'marker_tracker'
    assert result.sent == 60
    # Best effort: on a busy machine an image may be lost.
    assert min(result.processed, result.floor_taken) > 0.5 * result.sent
    # What is answered has been taken before.
    assert 0.0 < result.floor[0] < result.answer[0]
    assert result.limit is not None
    assert result.within_limits == (result.latency[0] <= result.limit)
    assert result.status['state'] == 'running'
    assert result.cpu_ms >= 0.0 and result.memory_mb > 20.0
    assert result.figures()['answer'] == result.answer

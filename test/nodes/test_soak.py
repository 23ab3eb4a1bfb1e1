"""Hours, in short: memory and latency stay where they are. MVUAV_SOAK: seconds (e.g. 1800)."""

import os
import statistics
import time

import pytest
from support.live_stream import Stream, memory_mb

SECONDS = float(os.environ.get('MVUAV_SOAK', '12'))
SETTLING = min(60.0, SECONDS / 3)
HZ = 60.0
DRIFT_SHOWS = 120.0
"""Seconds; in less, a latency tells of the machine's other work."""


@pytest.mark.long
def test_memory_and_latency_stay_where_they_are(graph):
    stream = Stream(graph, 'marker_tracker', 'runway_detector')
    memory = {name: [] for name in stream.processes}
    latency = {name: [] for name in stream.processes}
    end, sent, lost = time.monotonic() + SECONDS, 0, 0
    begun = time.monotonic()
    while time.monotonic() < end:
        sent += stream.play(3.0, HZ)
        for name, process in stream.processes.items():
            values = graph.diagnostics(name)
            lost = max(lost, int(values['frames_missing']) + int(values['frames_skipped']))
            if time.monotonic() - begun > SETTLING:
                memory[name].append(memory_mb(process.pid))
                latency[name].append(float(values['latency_p50_ms']))
            stream.answers[name].clear()
    for name in stream.processes:
        half = len(memory[name]) // 2
        growth = max(memory[name][half:]) - memory[name][0]
        first, last = (
            statistics.median(part) for part in (latency[name][:half], latency[name][half:])
        )
        print(
            f'{name}: {sent} frames, at most {lost} skipped or missing, memory '
            f'{memory[name][0]:.1f} {growth:+.1f} MB, latency p50 {first:.2f} -> {last:.2f} ms'
        )
        assert growth < 5.0
        if SECONDS >= DRIFT_SHOWS:
            assert last < 1.5 * first + 0.5
        assert graph.diagnostics(name)['frames_rejected'] == '0'
    stream.check_alive()

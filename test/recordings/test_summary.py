"""The summary says what is inside a recording, and what is wrong with it."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
from support.recording_samples import (
    IMAGE,
    START_NS,
    STEP_NS,
    TOPIC,
    Sample,
    cdr,
    image,
    image_samples,
    string_sample,
    write_mcap,
)

from mvuav_ros.recordings.summary import summarise


def test_rates_times_and_formats(tmp_path: Path) -> None:
    samples = [*image_samples(30), string_sample(31)]
    summary = summarise(write_mcap(tmp_path / 'a.mcap', samples))
    images, note = summary.topics
    assert summary.messages == 31
    assert summary.duration_s == pytest.approx(31 * STEP_NS / 1e9)
    assert (images.name, images.type, images.count) == (TOPIC, IMAGE, 30)
    assert images.rate_hz == pytest.approx(30)
    assert images.first_stamp_ns == START_NS
    assert images.duration_s == pytest.approx(29 * STEP_NS / 1e9)
    assert (images.gaps, images.jumps_back, summary.errors) == (0, 0, [])
    assert images.images is not None
    assert images.images.formats == ['64x48 mono8']
    assert (note.count, note.rate_hz, note.images) == (1, None, None)
    assert json.loads(json.dumps(dataclasses.asdict(summary)))['messages'] == 31


def test_gaps_jumps_and_malformed_images(tmp_path: Path) -> None:
    samples = image_samples(30)
    del samples[10:13]  # a gap of four intervals
    del samples[20]  # and one of two
    samples[5] = samples[5]._replace(data=samples[5].data[:100])
    short = image(8)
    short.data = short.data[:30]
    samples[8] = samples[8]._replace(data=cdr(short))
    samples.append(samples[-1]._replace(stamp_ns=samples[-1].stamp_ns + STEP_NS))
    early = Sample(TOPIC, IMAGE, START_NS, cdr(image(2, 32, 16)))
    (topic,) = summarise(write_mcap(tmp_path / 'a.mcap', [*samples, early])).topics
    assert topic.gaps == 2
    assert topic.longest_gap_s == pytest.approx(4 * STEP_NS / 1e9)
    assert topic.jumps_back == 1
    assert topic.rate_hz == pytest.approx(30)
    assert topic.first_stamp_ns == START_NS
    assert topic.images is not None
    assert topic.images.malformed == 2
    assert 'the message ends after 100 bytes' in topic.images.first_problem
    assert topic.images.header_jumps_back == 1
    assert topic.images.header_repeats == 1
    assert topic.images.formats == ['64x48 mono8', '32x16 mono8']


def test_messages_that_were_logged_in_batches_have_the_mean_rate(tmp_path: Path) -> None:
    batches = [
        s._replace(stamp_ns=START_NS + n // 5 * 10**9) for n, s in enumerate(image_samples(26))
    ]
    (topic,) = summarise(write_mcap(tmp_path / 'a.mcap', batches)).topics
    assert topic.rate_hz == pytest.approx(5.0)
    assert (topic.gaps, topic.jumps_back) == (0, 0)
    at_once = [sample._replace(stamp_ns=START_NS) for sample in image_samples(5)]
    (topic,) = summarise(write_mcap(tmp_path / 'b.mcap', at_once)).topics
    assert topic.rate_hz is None

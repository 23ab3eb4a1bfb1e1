"""A batch says what became of each recording."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from support.commands import mvuav, write_flight
from support.places import ROOT

from mvuav_ros.offline.replay.batch import Manifest
from mvuav_ros.offline.replay.job import ReplayJob, ReplayOutcome, ReplaySettings

NODE = ReplaySettings({'marker_tracker': {}})


def test_a_batch_tells_what_became_of_each(tmp_path: Path) -> None:
    good = write_flight(tmp_path / 'good.mcap', 6)
    bad = tmp_path / 'bad.mcap'
    bad.write_bytes(b'no recording')
    out = tmp_path / 'out'
    arguments = ('replay', good, bad, '-o', out, '--nodes', 'marker_tracker')
    assert mvuav(*arguments).status == 1
    manifest = json.loads((out / 'manifest.json').read_text())
    first, second = manifest['recordings']
    assert (first['input'], first['outcome'], first['frames']) == (str(good), 'finished', 6)
    assert int(first['input_bytes']) == good.stat().st_size
    assert first['output_bytes'] == (out / 'good.mcap').stat().st_size
    assert second['outcome'] == 'failed'
    assert 'is not a recording' in second['failure']
    assert manifest['settings']['parameters']['marker_tracker']['mode']
    assert manifest['started'] < manifest['ended']
    # What has failed is in nobody's way, and what is finished is not done again.
    mvuav(*arguments)
    again = json.loads((out / 'manifest.json').read_text())['recordings']
    assert [entry['outcome'] for entry in again] == ['finished before', 'failed']
    assert sorted(path.name for path in out.iterdir()) == ['good.mcap', 'manifest.json']


def test_batches_into_one_folder_at_the_same_time_keep_each_others_entries(tmp_path: Path) -> None:
    names = ('a', 'b')
    jobs = [
        ReplayJob(
            str(write_flight(tmp_path / f'{name}.mcap', 3)), str(tmp_path / f'out_{name}'), NODE
        )
        for name in names
    ]
    manifests = [Manifest(str(tmp_path), [job]) for job in jobs]
    for manifest, job in zip(manifests, jobs, strict=True):
        manifest.begin([job])
    for manifest, job in zip(manifests, jobs, strict=True):
        manifest.take(ReplayOutcome(job.source, job.output, frames=3, processed=3))
        manifest.end()
    entries = json.loads((tmp_path / 'manifest.json').read_text())['recordings']
    assert sorted((each['output'], each['outcome']) for each in entries) == [
        ('out_a', 'finished'),
        ('out_b', 'finished'),
    ]


def test_results_of_another_rig_are_not_taken_for_finished_ones(tmp_path: Path) -> None:
    flight, out, rig = write_flight(tmp_path / 'a.mcap', 3), tmp_path / 'out', tmp_path / 'rig.yaml'
    shutil.copy(ROOT / 'config' / 'tanker_747.yaml', rig)
    given = ('--nodes', 'marker_tracker', '--param', f'marker_tracker:layout:={rig}')
    arguments = ('replay', flight, '-o', out, *given)
    assert mvuav(*arguments).status == 0
    assert 'finished before' in mvuav(*arguments).out
    rig.write_text(rig.read_text().replace('29.8', '27.8'))
    assert '--force overwrites it' in mvuav(*arguments).error

"""Runs over recordings and the folder that keeps them."""

import asyncio
import csv
import io
import json
import os
import re
import shutil
import threading
from dataclasses import replace
from itertools import islice
from pathlib import Path

import pytest
from support.graph import ROOT

pytest.importorskip('nicegui', reason='the extra panel is not installed')

from mvuav_ros.offline.evaluation.evaluation_run import replay
from mvuav_ros.offline.evaluation.metrics import metrics_of
from mvuav_ros.offline.replay.job import ReplaySettings
from mvuav_ros.offline.report import csv_text
from mvuav_ros.offline.stopping import Stop
from mvuav_ros.panel.page.run_list import chart_options
from mvuav_ros.panel.reel import Reel, Wanted
from mvuav_ros.panel.runs import (
    RESULTS,
    Run,
    Runner,
    RunStore,
    find_bags,
    run_table,
    varied,
)
from mvuav_ros.panel.sanitized import NameRefusedError
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.writing import RecordingWriter

BAG = ROOT / 'bags' / 'runway.mcap'
KIND = 'runway_detector'
VALUES = {**RunwayDetectorParameters().as_dict(), 'num_peaks': 2}


def run(name, store, source=BAG, look=lambda runner: None):
    """The runner, and what it said whenever it went on; ``look`` is called then."""
    said = []

    def changed():
        said.append((runner.words, runner.fraction))
        look(runner)

    runner = Runner(store, changed)
    asyncio.run(runner.replay(Run(name, KIND, str(source), VALUES), store.new_folder(name)))
    return runner, said


@pytest.fixture(scope='module')
def made(tmp_path_factory):
    store = RunStore(tmp_path_factory.mktemp('data') / 'runs')
    runner, said = run('first', store)
    return store, runner.last, said


def test_a_run_keeps_parameters_results_input_and_version(made):
    store, done, said = made
    (kept,) = store.all()
    assert kept == done
    assert kept.parameters == VALUES and kept.source == str(BAG) and kept.version
    assert kept.frames == kept.answered == 150 and kept.image_topic == ''
    assert said[:2] == [('starting', 0.0), ('0 of 150 frames', 0.0)]
    assert said[-1] == ('150 of 150 frames', 1.0)
    with open_recording(store.folder / 'first' / RESULTS) as recording:
        assert len(list(recording.messages({f'/{KIND}/line_params'}))) == 150


def test_its_numbers_are_those_of_a_sweep(made):
    numbers = {m.name: m.value for m in made[1].metrics}
    settings = ReplaySettings({KIND: VALUES})
    expected = {m.name: m.value for m in metrics_of(replay(str(BAG), settings))}
    del expected['time per frame']
    assert numbers == pytest.approx(expected, nan_ok=True)


def test_a_run_has_the_attitude_of_the_topic_that_is_chosen(tmp_path):
    """As `mvuav replay --imu-topic`; of a name of its own it was never used."""
    bag, own, values = tmp_path / 'flight.mcap', '/mavros/imu/data', {**VALUES, 'mode': 'approach'}
    with open_recording(BAG) as recording, RecordingWriter(bag) as writer:
        for message in islice(recording.messages(), 60):
            topic = message.topic.replace('/imu', own)
            writer.write(topic, message.type, message.stamp_ns, message.data)
    store, asked = RunStore(tmp_path / 'runs'), Run('', KIND, str(bag), values)
    found = []
    for number, topic in enumerate((own, '/elsewhere')):
        runner = Runner(store, lambda: None)
        run = replace(asked, name=f'run {number}', imu_topic=topic)
        assert asyncio.run(runner.replay(run, store.new_folder(run.name)))
        with open_recording(store.folder / run.name / RESULTS) as recording:
            found.append([m.data for m in recording.messages({f'/{KIND}/line_params'})])
    assert [run.imu_topic for run in store.all()] == [own, '']
    assert found[0] != found[1]
    reel = Reel()
    shown = [
        reel(Wanted(str(bag), 0.0, KIND, 9, (values,), ('', '', topic)), lambda _: None, Stop())
        for topic in ('/elsewhere', own)
    ]
    assert [each.topics[2] for each in shown] == [('', (own,)), (own, (own,))]
    assert shown[0].results[0].jpeg != shown[1].results[0].jpeg


def test_a_run_has_the_calibration_of_the_topic_that_the_node_listens_to(tmp_path):
    """As `mvuav replay --camera-info-topic`; beside the images alone it was never used."""
    bag, own, kind = tmp_path / 'flight.mcap', '/rig/left_info', 'marker_tracker'
    with open_recording(ROOT / 'bags' / 'tanker.mcap') as recording, RecordingWriter(bag) as writer:
        for message in islice(recording.messages({'/image_raw', '/camera_info'}), 40):
            topic = message.topic.replace('/camera_info', own)
            writer.write(topic, message.type, message.stamp_ns, message.data)
    store, values = RunStore(tmp_path / 'runs'), MarkerTrackerParameters().as_dict()
    given = {own: own, '/elsewhere': ''}
    for topic in given:
        run = Run(store.free_name(), kind, str(bag), values, camera_info_topic=topic)
        runner = Runner(store, lambda: None)
        assert asyncio.run(runner.replay(run, store.new_folder(run.name)))
    assert [run.camera_info_topic for run in store.all()] == [*given.values()]
    found = [
        len([*recording.messages({f'/{kind}/vision_pose'})])
        for recording in (open_recording(store.folder / r.name / RESULTS) for r in store.all())
    ]
    assert found[0] > 10 and found[1] == 0
    reel = Reel()
    for images, named, used in (('', own, own), ('', '/elsewhere', ''), ('/other', own, '')):
        wanted = Wanted(str(bag), 0.0, kind, 9, (values,), (images, named, ''))
        shown = reel(wanted, lambda _: None, Stop())
        assert shown.topics == (('/image_raw', ('/image_raw',)), (used, (own,)))
        assert ('no pose' in shown.results[0].said['trust'][1]) == (not used)
        reel = Reel()


def test_a_run_that_fails_says_why_and_is_not_listed(made, tmp_path):
    store, _, _ = made
    broken = tmp_path / 'broken.mcap'
    broken.write_bytes(b'no bag')
    runner, _ = run('broken', store, broken)
    assert runner.words.startswith('failed: ') and 'broken.mcap' in runner.words
    assert not runner.is_busy and runner.last is None
    assert not (store.folder / 'broken').exists()


def test_a_run_over_a_damaged_recording_says_what_is_lost(tmp_path):
    cut, store = tmp_path / 'cut.mcap', RunStore(tmp_path / 'runs')
    cut.write_bytes(BAG.read_bytes()[: BAG.stat().st_size // 2])
    runner, _ = run('half', store, cut)
    (kept,) = store.all()
    assert 0 < kept.frames < 150 and 'cut off' in kept.lost
    assert runner.words == f'{kept.answered} of {kept.frames} frames; {kept.lost}'
    torn = tmp_path / 'torn.mcap'
    with open_recording(BAG) as recording, RecordingWriter(torn) as writer:
        for number, message in enumerate(islice(recording.messages({'/image_raw'}), 5)):
            data = message.data[:100] if number == 2 else message.data
            writer.write(message.topic, message.type, message.stamp_ns, data)
    runner, _ = run('torn', store, torn)
    assert (runner.last.answered, runner.last.frames) == (4, 5)
    assert {m.name: m.value for m in runner.last.metrics}['frames rejected'] == 1


def test_a_run_can_be_cancelled(made):
    store, _, _ = made
    runner, _ = run('cancelled', store, look=lambda runner: runner._cancelled or runner.cancel())
    assert runner.words == 'cancelled' and runner.last is None
    assert not (store.folder / 'cancelled').exists()


def test_names_stay_in_the_folder_and_are_given_once(made):
    store, _, _ = made
    for name in ('../out', 'a/b', '', '..'):
        with pytest.raises(NameRefusedError):
            store.new_folder(name)
        with pytest.raises(NameRefusedError):
            store.delete(name)
    with pytest.raises(NameRefusedError, match='already'):
        store.new_folder('first')
    assert store.free_name() == 'run 1'


def test_damaged_runs_are_left_out_and_deleted_ones_gone(made, tmp_path):
    store = RunStore(tmp_path / 'runs')
    shutil.copytree(made[0].folder / 'first', store.folder / 'first')
    for name, words in (('one', '{'), ('two', '{}'), ('three', '[]'), ('four', '[' * 100_000)):
        (store.folder / name).mkdir()
        (store.folder / name / 'run.json').write_text(words)
    sound = (store.folder / 'first' / 'run.json').read_text()
    made_at = re.compile(r'"made": [^,]+')
    for number, words in enumerate(('1e400', '-1', 'NaN', '1e18', '1' * 5000)):
        (store.folder / f'made {number}').mkdir()
        bad = made_at.sub(f'"made": {words}', sound)
        assert bad != sound
        (store.folder / f'made {number}' / 'run.json').write_text(bad)
    (store.folder / 'more').mkdir()
    more = sound.replace('"answered": 150', '"answered": 151')
    (store.folder / 'more' / 'run.json').write_text(more)
    (store.folder / 'fifo').mkdir()
    os.mkfifo(store.folder / 'fifo' / 'run.json')
    found = []
    thread = threading.Thread(target=lambda: found.extend(store.all()), daemon=True)
    thread.start()
    thread.join(60.0)
    assert not thread.is_alive(), 'it waits for somebody to write into a FIFO'
    assert [each.name for each in found] == ['first']
    bad = {
        'one',
        'two',
        'three',
        'four',
        'more',
        'fifo',
        *(f'made {number}' for number in range(5)),
    }
    assert store.rejected.keys() == bad and all(store.rejected.values())
    store.delete('first')
    assert store.all() == [] and not (store.folder / 'first').exists()


def test_a_run_is_there_as_a_whole_or_not_at_all(made, tmp_path, monkeypatch):
    """One that was killed kept its name, and could be neither made again nor deleted."""
    store, written = RunStore(tmp_path), Path.write_text

    def cut_short(path, text, **how):
        written(path, text[: len(text) // 2], **how)
        # What another page sees meanwhile.
        assert store.all() == [] and store.rejected == {}
        raise OSError('no space left on device')

    folder = store.new_folder('first')
    (folder / RESULTS).touch()
    with monkeypatch.context() as patched, pytest.raises(OSError, match='no space'):
        patched.setattr(Path, 'write_text', cut_short)
        store.finish(made[1], folder)
    # Another panel, after this one was killed.
    store = RunStore(tmp_path)
    assert store.all() == [] and store.rejected == {}
    folder = store.new_folder('first')
    assert not [*folder.iterdir()]
    store.finish(made[1], folder)
    assert store.all() == [made[1]] and [path.name for path in tmp_path.iterdir()] == ['first']


def test_trends_over_names_and_over_a_parameter_that_differs(made):
    _, done, _ = made
    other = replace(done, name='second', parameters={**VALUES, 'num_peaks': 1, 'mode': 'approach'})
    runs = [done, other]
    rows = list(csv.DictReader(io.StringIO(csv_text(run_table(runs)))))
    assert [row['run'] for row in rows] == ['first', 'second']
    assert rows[0]['num_peaks'] == '2' and float(rows[0]['rho flags [frames]']) >= 0
    assert varied(runs) == ['mode', 'num_peaks'] and varied([done]) == []
    columns = ['rho flags', 'theta flags']
    named = chart_options(runs, columns, 'run')
    assert named['xAxis']['data'] == ['first', 'second']
    over = chart_options(runs, columns, 'num_peaks')
    assert over['xAxis']['data'] == ['num_peaks 1', 'num_peaks 2']
    assert [line['name'] for line in over['series']] == columns
    bars = chart_options(runs, columns, 'run', grouped=True)
    assert bars['xAxis']['data'] == columns
    assert [bar['name'] for bar in bars['series']] == ['first', 'second']


def test_a_saved_run_has_a_report(made):
    store, _, _ = made
    page = store.report('first')
    assert page is not None and 'Results against truth' in page.read_text()
    assert store.report('../first') is None and store.report('none') is None


def test_numbers_that_are_missing_survive_json(made):
    content = json.loads((made[0].folder / 'first' / 'run.json').read_text())
    assert all(m['value'] is None or isinstance(m['value'], float) for m in content['metrics'])


def test_recordings_are_found_below_the_folders_and_nowhere_else(tmp_path):
    (tmp_path / 'deep').mkdir()
    for name in ('a.mcap', 'deep/b.db3', 'c.txt'):
        (tmp_path / name).touch()
    assert list(find_bags([tmp_path])) == ['a.mcap', 'deep/b.db3']
    assert find_bags([BAG]) == {'runway.mcap': BAG}
    # Whoever names a file is told what is wrong with it.
    named = tmp_path / 'flight.avi'
    named.touch()
    assert find_bags([named]) == {'flight.avi': named}
    assert find_bags([BAG.parent, BAG]) == find_bags([BAG.parent])


def test_recordings_are_found_however_ros2_bag_stores_them(tmp_path):
    split = tmp_path / 'monday' / 'split'
    split.mkdir(parents=True)
    parts = [split / f'split_{number}.mcap.zstd' for number in range(3)]
    for path in (*parts, split / 'metadata.yaml', tmp_path / 'NOSE.MCAP', tmp_path / 'a.db3.zstd'):
        path.touch()
    found = find_bags([tmp_path])
    assert found == {name: tmp_path / name for name in ('NOSE.MCAP', 'a.db3.zstd', 'monday/split')}
    assert find_bags([split]) == {'split': split}
    assert find_bags([parts[1]]) == {parts[1].name: parts[1]}


def test_recordings_of_the_same_name_are_all_found(tmp_path):
    days = [tmp_path / day for day in ('monday', 'tuesday')]
    paths = [
        day / f'{name}.mcap' for day in days for name in ('flight', 240 * 'a', 240 * 'a' + 'b')
    ]
    for path in paths:
        path.parent.mkdir(exist_ok=True)
        path.touch()
    found = find_bags(days)
    assert sorted(found.values()) == sorted(paths)
    assert found['flight.mcap'] == paths[0] and found[str(paths[3])] == paths[3]

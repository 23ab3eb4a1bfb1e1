import csv
import json
import math
import os
import re
import shutil
import signal
import struct
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.commands import NO_POSE, mvuav, read
from support.flights import write_bag
from support.places import ROOT
from typer.testing import CliRunner

from mvuav_ros.cli.app import application
from mvuav_ros.offline.evaluation.evaluation_run import replay
from mvuav_ros.offline.evaluation.metrics import line_errors, metrics_of
from mvuav_ros.offline.parameter_sweep import (
    parse_axis,
    plan_runs,
    sweep,
    sweep_report,
)
from mvuav_ros.offline.replay.batch import plan
from mvuav_ros.offline.replay.job import ReplaySettings
from mvuav_ros.offline.report import Figure, write_report
from mvuav_ros.offline.stopping import Interrupted
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.writing import RecordingWriter

FLIGHT = 'sim:tanker?frames=6&noise=0'
TRACKED = ReplaySettings({'marker_tracker': {}})


def run(*arguments):
    result = CliRunner().invoke(application(), [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def _in_order(results):
    return sorted(results, key=lambda result: result.run.number)


def rows_of(path):
    with path.open() as stream:
        return list(csv.DictReader(stream))


def test_an_axis_has_the_parameters_type():
    axis = parse_axis('marker_tracker:search_radius:=4, 6,8')
    assert (axis.title, axis.values) == ('marker_tracker:search_radius', (4, 6, 8))
    assert parse_axis('marker_tracker:threshold:=1,0.5').values == (1.0, 0.5)
    assert parse_axis('marker_tracker:prediction:=velocity').values == ('velocity',)
    mount = 'runway_detector:camera_mount_rpy_deg'
    assert parse_axis(f'{mount}:=[0,8,0], [0,9.5,0]').values == ((0, 8, 0), (0, 9.5, 0))


@pytest.mark.parametrize(
    'text',
    [
        'marker_tracker:search_radius',
        'marker_tracker:search_radius:=',
        'marker_tracker:search_radius:=4,,6',
        'marker_tracker:search_radius:=4,zero',
        'marker_tracker:search_radius:=4,0',
        'marker_tracker:nothing:=4',
        'nobody:search_radius:=4',
        'search_radius:=4',
    ],
)
def test_an_axis_that_cannot_be_is_refused(text):
    with pytest.raises(ParameterError):
        parse_axis(text)


def test_runs_cover_the_grid_on_every_input():
    axes = [
        parse_axis('marker_tracker:search_radius:=4,6,8'),
        parse_axis('runway_detector:num_peaks:=2,3'),
    ]
    base = {'marker_tracker': {'threshold': 0.6}, 'runway_detector': {}}
    settings = ReplaySettings(base, image_topic='/nose', gamma=2.0)
    runs = plan_runs(['a', 'b'], axes, settings)
    assert [r.number for r in runs] == list(range(1, 13))
    assert {(r.source, *r.values) for r in runs} == {
        (s, radius, peaks) for s in 'ab' for radius in (4, 6, 8) for peaks in (2, 3)
    }
    for planned in runs:
        radius, peaks = planned.values
        assert planned.settings.parameters == {
            'marker_tracker': {'threshold': 0.6, 'search_radius': radius},
            'runway_detector': {'num_peaks': peaks},
        }
        assert replace(planned.settings, parameters=base) == settings
    with pytest.raises(ParameterError, match='twice'):
        plan_runs(['a'], [axes[0], axes[0]], settings)


def numbers(results):
    """Everything but times."""
    return [
        # As text, since NaN is not equal to itself.
        (r.run.values, r.error, repr([m for m in r.metrics if 'time' not in m.group]))
        for r in _in_order(results)
    ]


def test_processes_and_dask_give_the_same_numbers(tmp_path):
    distributed = pytest.importorskip('distributed')
    axes = [parse_axis('marker_tracker:threshold:=0.5,0.999')]
    runs = plan_runs([FLIGHT, str(tmp_path / 'nothing.mcap')], axes, TRACKED)
    here = numbers(sweep(runs))
    assert [bool(error) for _, error, _ in here] == [False, False, True, True]
    assert here[0][2] != here[1][2]
    assert numbers(sweep(runs, jobs=2)) == here
    with distributed.LocalCluster(
        n_workers=1, processes=False, protocol='tcp', dashboard_address=None
    ) as cluster:
        assert numbers(sweep(runs, dask=cluster.scheduler_address)) == here


def test_a_cluster_finds_what_is_named_from_here(tmp_path, monkeypatch):
    distributed = pytest.importorskip('distributed')
    name = write_bag(tmp_path / 'a.mcap', results=False).name
    runs = plan_runs([name], [], TRACKED)
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, protocol='tcp', dashboard_address=None
    ) as cluster:
        monkeypatch.chdir(tmp_path)
        (result,) = sweep(runs, dask=cluster.scheduler_address)
    assert (result.error, result.run.source) == ('', name)


def test_a_cluster_finds_a_rig_that_is_named_from_here(tmp_path, monkeypatch):
    distributed = pytest.importorskip('distributed')
    shutil.copy(Path(ROOT) / 'config' / 'tanker_747.yaml', tmp_path / 'rig.yaml')
    given = ReplaySettings({'marker_tracker': {'layout': 'rig.yaml'}})
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, protocol='tcp', dashboard_address=None
    ) as cluster:
        monkeypatch.chdir(tmp_path)
        axis = parse_axis('marker_tracker:layout:=rig.yaml')
        for runs in (plan_runs([FLIGHT], [], given), plan_runs([FLIGHT], [axis], TRACKED)):
            (result,) = sweep(runs, dask=cluster.scheduler_address)
            assert (result.error, result.run) == ('', runs[0])
        # A replay's jobs take their paths from the same settings.
        (job,) = plan([FLIGHT], str(tmp_path / 'out.mcap'), given, absolute=True).jobs
        assert job.settings.parameters['marker_tracker']['layout'] == str(tmp_path / 'rig.yaml')


@pytest.fixture
def unusual(tmp_path):
    """A flight to a runway with its truth, whose attitude is on a topic of its own."""
    flight, bag = tmp_path / 'simulated.mcap', tmp_path / 'flight.mcap'
    small = ('--size', '320x240', '--frames', 12, '--start-distance', 100)
    assert run('simulate', 'runway', '-o', flight, *small).exit_code == 0
    with open_recording(flight) as recording, RecordingWriter(bag) as writer:
        for message in recording.messages():
            topic = message.topic.replace('/imu', '/mavros/imu/data')
            writer.write(topic, message.type, message.stamp_ns, message.data)
    return flight, bag


APPROACH = ('runway_detector:mode:=approach', 'runway_detector:horizon_source:=imu')


def test_a_run_is_described_alike_wherever_it_is_made(unusual, tmp_path, monkeypatch):
    """Evaluation and sweep took their own words for it, and had no attitude here."""
    # Of the reports only the tables are read.
    monkeypatch.setattr('matplotlib.figure.Figure.savefig', lambda *_, **__: None)
    flight, bag = unusual
    parameters = {'mode': 'approach', 'horizon_source': 'imu'}
    settings = ReplaySettings({'runway_detector': parameters})
    expected = metrics_of(replay(str(flight), settings))
    named = replace(settings, imu_topic='/mavros/imu/data')

    def alike(metrics):
        kept = [[m for m in each if 'time' not in m.group] for each in (metrics, expected)]
        return repr(kept[0]) == repr(kept[1])

    assert alike(metrics_of(replay(str(bag), named)))
    assert not alike(metrics_of(replay(str(bag), settings)))
    (result,) = sweep(plan_runs([str(bag)], [], named))
    assert alike(result.metrics)
    given = [word for text in APPROACH for word in ('--param', text)]
    topic = ('--imu-topic', '/mavros/imu/data')
    tables = {}
    for source, more in ((flight, ()), (bag, topic), (bag, ())):
        for command in ('evaluate', 'sweep'):
            done = mvuav(command, source, '-o', tmp_path / command, *given, *more, '--force')
            assert done.status == 0
            said = 'no attitude is used; --imu-topic names its topic: /mavros/imu/data'
            assert (said in done.err) == (source == bag and not more)
            report = json.loads((tmp_path / command / 'report.json').read_text())
            assert report['settings'].get('imu_topic') == (topic[1] if more else None)
            found = {row['line']: row for row in report['tables'].get('lines', ())}
            tables[source, more, command] = found
    assert tables[flight, (), 'evaluate'] == tables[bag, topic, 'evaluate'] != {}
    with pytest.raises(RecordingError, match='no imu topic /imu/data; there is /mavros/imu/data'):
        replay(str(bag), replace(settings, imu_topic='/imu/data'))


def test_what_says_how_the_nodes_run_has_them_run(tmp_path):
    """Over a bag with their results as well, where it had no effect."""
    bag = write_bag(tmp_path / 'flight.mcap', results=True)
    for number, (option, frames) in enumerate(((('--every', 2), 3), (('--gamma', 2.0), 6))):
        done = run('evaluate', bag, '-o', tmp_path / str(number), *option)
        assert done.exit_code == 0
        report = json.loads((tmp_path / str(number) / 'report.json').read_text())
        assert 'replayed' in report['settings']['results']
        (found,) = (r for r in report['tables']['metrics'] if r['what'] == 'frames')
        assert found['value'] == frames


def test_a_replay_of_a_simulated_flight_keeps_what_a_bag_of_it_holds(tmp_path):
    """The attitude as well, which was left out."""
    out = tmp_path / 'out.mcap'
    given = ('-o', out, '--keep-inputs', '--nodes', 'marker_tracker')
    assert mvuav('replay', FLIGHT, *given).status == 0
    assert run('evaluate', out, '-o', tmp_path / 'report').exit_code == 0
    report = json.loads((tmp_path / 'report' / 'report.json').read_text())
    assert report['settings']['results'] == "the bag's own"
    assert {row['marker'] for row in report['tables']['markers']} >= {'rudder', 'all 5'}
    bag = tmp_path / 'bag.mcap'
    small = ('--width', 320, '--height', 240, '--frames', 2)
    assert mvuav('simulate', 'runway', '-o', bag, *small).status == 0
    flight = 'sim:runway?width=320&height=240&frames=2'
    assert mvuav('replay', flight, '-o', out, '--keep-inputs', '--force').status == 0
    kept = [
        message
        for message in read(out)
        if message.topic.count('/') < 2 or '/truth' in message.topic
    ]
    assert kept == read(bag)


def test_sweep_writes_table_and_trends_and_reports_a_failed_run(tmp_path):
    out = tmp_path / 'out'
    given = ('--param', 'runway_detector:rho_error_threshold:=1,1000', '-o', out)
    flight = 'sim:runway?frames=12&width=320&height=240&motion=s_turn&start_distance=100'
    result = run('sweep', flight, tmp_path / 'none.mcap', *given)
    assert result.exit_code == 1
    assert 'failed' in result.output
    rows = rows_of(out / 'sweep.csv')
    assert [row['runway_detector:rho_error_threshold'] for row in rows] == ['1', '1000'] * 2
    assert [bool(row['error']) for row in rows] == [False, False, True, True]
    assert float(rows[0]['rho flags [frames]']) > float(rows[1]['rho flags [frames]']) == 0.0
    for name in ('trends_subplot', 'trend_flag_counts', 'grouped_average_rho'):
        assert (out / f'{name}.png').stat().st_size > 5000
    page = (out / 'index.html').read_text()
    assert 'rho_error_threshold' in page
    assert not re.search(r'(src|href)="http', page)
    with pytest.raises(RecordingError, match='--force'):
        run('sweep', flight, *given)


def test_the_trends_are_over_the_parameter_that_changes():
    """Whatever else is given with one value, as the rig of the body is."""
    threshold, given = map(
        parse_axis, ('marker_tracker:threshold:=0.5,0.6', 'marker_tracker:centroid:=binary')
    )
    results = _in_order(sweep(plan_runs([FLIGHT], [given, threshold], TRACKED)))
    alone = [replace(r, run=replace(r.run, values=r.run.values[1:])) for r in results]

    def figures(results, axes):
        sections = sweep_report(results, axes, {}).sections
        return {f.key: f.png for s in sections for f in s.items if isinstance(f, Figure)}

    drawn = figures(results, [given, threshold])
    assert len(drawn) > 10 and drawn == figures(alone, [threshold])
    other = figures(alone, [replace(threshold, name='min_area')])
    assert other['trends_subplot'] != drawn['trends_subplot'], 'it does not name the parameter'


def test_a_run_over_a_url_has_the_bags_truth(tmp_path):
    pytest.importorskip('fsspec', reason='fsspec is not installed')
    bag = write_bag(tmp_path / 'flight.mcap', results=False)
    here, there = (replay(text, TRACKED) for text in (str(bag), f'file://{bag}'))
    assert there.truth.stamps == here.truth.stamps != set()
    assert {m.name for m in metrics_of(there)} == {m.name for m in metrics_of(here)}


@pytest.mark.parametrize('finished', [0, 2])
def test_an_interrupted_sweep_leaves_the_finished_runs(tmp_path, monkeypatch, finished):
    def interrupted(runs, *_):
        yield from sweep(runs[:finished])
        raise Interrupted(signal.SIGINT)

    monkeypatch.setattr('mvuav_ros.offline.parameter_sweep.sweep', interrupted)
    given = ('--param', 'marker_tracker:threshold:=0.5,0.6,0.7')
    swept = mvuav('sweep', FLIGHT, *given, '-o', tmp_path / 'out')
    assert (swept.status, swept.error) == (130, 'mvuav: interrupted')
    left = [row['run'] for path in tmp_path.glob('out/sweep.csv') for row in rows_of(path)]
    assert left == ['1', '2'][:finished]
    assert (tmp_path / 'out' / 'index.html').exists() == bool(finished)
    assert ('2 of 3 runs' in swept.out) == bool(finished)


@pytest.mark.parametrize('command', [('evaluate',), ('evaluate', 'bag')])
def test_evaluate_takes_a_bag(tmp_path, command):
    bag = write_bag(tmp_path / 'flight.mcap', results=True)
    out = tmp_path / 'out'
    result = run(*command, bag, '-o', out)
    assert result.exit_code == 0
    assert 'detected markers, RMS error' in result.output
    report = json.loads((out / 'report.json').read_text())
    assert report['settings']['results'] == "the bag's own"
    assert {row['marker'] for row in report['tables']['markers']} >= {'rudder', 'all 5'}
    with pytest.raises(RecordingError, match='--force'):
        run(*command, bag, '-o', out)
    changed = run(*command, bag, '-o', out, '--force', '--param', 'marker_tracker:threshold:=0.5')
    assert changed.exit_code == 0
    assert 'replayed' in json.loads((out / 'report.json').read_text())['settings']['results']


def test_evaluate_runs_the_node_where_the_bag_has_no_results(tmp_path):
    bag = write_bag(tmp_path / 'flight.mcap', results=False)
    assert run('evaluate', bag, '-o', tmp_path / 'out').exit_code == 0
    assert (tmp_path / 'out' / 'roll_over_time.png').exists()


def test_evaluate_says_that_there_is_no_pose_without_a_calibration(tmp_path):
    bag, plain = write_bag(tmp_path / 'flight.mcap', results=False), tmp_path / 'plain.mcap'
    with open_recording(bag) as recording, RecordingWriter(plain) as writer:
        for message in recording.messages():
            if message.topic != '/camera_info':
                writer.write(*message)
    assert 'no pose' not in mvuav('evaluate', bag, '-o', tmp_path / 'a').err
    assert mvuav('evaluate', plain, '-o', tmp_path / 'b').err == NO_POSE


@pytest.mark.parametrize('results', [True, False])
def test_evaluate_takes_a_url(tmp_path, results):
    files = pytest.importorskip('fsspec').filesystem('memory')
    files.put(str(write_bag(tmp_path / 'a.mcap', results=results)), '/evaluated/a.mcap')
    given = ('evaluate', 'memory://evaluated/a.mcap', '-o', tmp_path / 'out')
    assert 'roll, RMS error' in run(*given).output
    report = json.loads((tmp_path / 'out' / 'report.json').read_text())
    assert report['settings']['input'] == 'memory://evaluated/a.mcap'


def test_a_mistyped_input_is_not_taken_for_a_report_in_the_way(tmp_path):
    (tmp_path / 'index.html').touch()
    with pytest.raises(RecordingError, match=r'nowhere\.mcap does not exist'):
        run('evaluate', 'nowhere.mcap', '-o', tmp_path)


@pytest.mark.parametrize(
    ('work', 'command'),
    [
        ('mvuav_thesis.build.build_report', ('evaluate', 'thesis', '--quick')),
        ('mvuav_ros.offline.evaluation.protection.run', ('evaluate', 'integrity')),
        ('mvuav_ros.offline.evaluation.evaluation_run.replay', ('evaluate', FLIGHT)),
        (
            'mvuav_ros.offline.parameter_sweep.sweep',
            ('sweep', FLIGHT, '--param', 'marker_tracker:threshold:=0.5,0.6'),
        ),
    ],
)
@pytest.mark.parametrize(
    ('out', 'reason'), [('file', 'File exists'), ('file/a', 'Not a directory')]
)
def test_an_output_that_cannot_be_a_folder_is_refused_before_the_work(
    tmp_path, monkeypatch, work, command, out, reason
):
    (tmp_path / 'file').touch()
    monkeypatch.setattr(work, lambda *_, **__: pytest.fail('it has begun to work'))
    refused = mvuav(*command, '-o', tmp_path / out)
    assert refused.status == 1 and reason in refused.err


def test_evaluate_needs_truth(tmp_path):
    from mvuav_ros.recordings.writing import RecordingWriter

    with RecordingWriter(tmp_path / 'empty.mcap'):
        pass
    with pytest.raises(RecordingError, match=r'holds no truth.* replay --keep-inputs keeps it'):
        run('evaluate', tmp_path / 'empty.mcap', '-o', tmp_path / 'out')


def test_a_sweep_leaves_the_page_of_an_evaluation(tmp_path):
    page = tmp_path / 'index.html'
    page.write_text('of an evaluation')
    with pytest.raises(RecordingError, match=r'index\.html exists; --force'):
        run('sweep', 'sim:tanker?frames=2', '-o', tmp_path)
    assert page.read_text() == 'of an evaluation'


def test_a_sweep_says_what_of_a_recording_is_missing(tmp_path):
    bag = write_bag(tmp_path / 'cut.mcap', results=False)
    bag.write_bytes(bag.read_bytes()[:-2000])
    axis = parse_axis('marker_tracker:threshold:=0.5,0.6')
    runs = plan_runs([str(bag)], [axis], TRACKED)
    results = _in_order(sweep(runs))
    assert all(result.metrics and result.losses for result in results)
    lead = sweep_report(results, [axis], {}).lead
    assert sum('not all is in it' in line for line in lead) >= len(runs) == 2


def test_the_loss_of_an_input_is_said_once_however_often_it_is_read(tmp_path):
    bag = write_bag(tmp_path / 'cut.mcap', results=True)
    bag.write_bytes(bag.read_bytes()[:-2000])
    given = ('--param', 'marker_tracker:threshold:=0.5,0.6', '--json')
    swept = mvuav('sweep', bag, '-o', tmp_path / 'sweep', *given)
    evaluated = mvuav('evaluate', bag, '-o', tmp_path / 'evaluation', '--json')
    for done in (swept, evaluated):
        lines = done.err.splitlines()
        assert done.status == 0 and len(set(lines)) == len(lines) == 3
        (account,) = json.loads(done.out)['accounts']
        # Of each frame the truth and the results: markers and roll, and the true pose.
        assert account['kept'] == 5 * 6
    flights = [tmp_path / name / 'flight.avi' for name in ('one', 'two')]
    for flight in flights:
        flight.parent.mkdir()
        writer = cv2.VideoWriter(str(flight), cv2.VideoWriter.fourcc(*'MJPG'), 20.0, (64, 48))
        writer.write(np.full((48, 64, 3), 90, np.uint8))
        writer.release()
    swept = mvuav('sweep', *flights, '-o', tmp_path / 'videos', '--json')
    names = [account['name'] for account in json.loads(swept.out)['accounts']]
    assert names == [f'video {flight}' for flight in flights]


def test_lines_that_were_never_in_view_are_not_said_to_be_missed():
    flight = 'sim:runway?frames=2&width=320&height=240&camera_pitch_deg=60&start_distance=900'
    replayed = replay(flight, ReplaySettings({'runway_detector': {}}))
    lines = line_errors(replayed)
    assert lines is not None and sum(lines.visible) == 0
    (found,) = (m.value for m in metrics_of(replayed) if m.name == 'true lines found')
    assert math.isnan(found)


def test_a_sweep_of_inputs_with_odd_names(tmp_path):
    bag = write_bag(tmp_path / 'flight.mcap', results=False)
    names = 'a${$.mcap', '_b.mcap', os.fsdecode(b'\xff.mcap')
    sources = [str(shutil.copy(bag, tmp_path / name)) for name in names]
    axis = parse_axis('marker_tracker:threshold:=0.5,0.6')
    results = _in_order(sweep(plan_runs(sources, [axis], TRACKED)))
    page = write_report(sweep_report(results, [axis], {}), tmp_path / 'out')
    assert page.exists() and len(list((tmp_path / 'out').glob('*.png'))) > 3


@pytest.mark.parametrize('results', [False, True])
def test_truth_of_other_stamps_is_not_passed_over(tmp_path, results):
    """As of another clock, or of a sensor with a rate of its own."""
    bag, late = write_bag(tmp_path / 'flight.mcap', results), tmp_path / 'late.mcap'
    with open_recording(bag) as recording, RecordingWriter(late) as writer:
        for topic, kind, stamp_ns, data, *rest in recording.messages():
            if topic.startswith('/truth/'):
                (nanoseconds,) = struct.unpack_from('<I', data, 8)
                data = data[:8] + struct.pack('<I', nanoseconds + 1000) + data[12:]
            writer.write(topic, kind, stamp_ns, data, *rest)
    evaluated = mvuav('evaluate', late, '-o', tmp_path / 'evaluation')
    assert evaluated.status == 1
    assert 'no result has the stamp of any truth' in evaluated.err
    axis = parse_axis('marker_tracker:threshold:=0.5')
    (result,) = sweep(plan_runs([str(late)], [axis], TRACKED))
    assert any('the stamp of any truth' in loss for loss in result.losses)


def test_results_of_another_kind_than_the_truth_are_not_passed_over(tmp_path):
    other = tmp_path / 'other.mcap'
    assert (
        mvuav('replay', FLIGHT, '-o', other, '--nodes', 'runway_detector', '--keep-inputs')[0] == 0
    )
    refused = mvuav('evaluate', other, '-o', tmp_path / 'out')
    assert refused.status == 1 and 'no result is of what its truth says; --replay' in refused.error
    run = mvuav('evaluate', other, '-o', tmp_path / 'out', '--replay')
    assert run.status == 0 and 'roll, RMS error' in run.out


def test_a_sweep_of_a_folder_is_one_of_each_of_its_recordings(tmp_path):
    bag = write_bag(tmp_path / 'flight.mcap', results=False)
    (tmp_path / 'season').mkdir()
    for name in ('b.mcap', 'a.mcap'):
        shutil.copy(bag, tmp_path / 'season' / name)
    axis = parse_axis('marker_tracker:threshold:=0.5,0.6')
    runs = plan_runs([str(tmp_path / 'season'), FLIGHT], [axis], TRACKED)
    names = [Path(run.source).name for run in runs if run.source != FLIGHT]
    assert names == ['a.mcap', 'a.mcap', 'b.mcap', 'b.mcap'] and len(runs) == 6
    assert not any(result.error for result in sweep(runs[:4]))


def test_integrity_of_no_frames_is_refused(tmp_path):
    assert run('evaluate', 'integrity', '--frames', 0, '-o', tmp_path).exit_code == 2


def test_faults_more_often_than_they_are_flown_are_refused(tmp_path):
    assert run('evaluate', 'integrity', '--factor', 5001, '-o', tmp_path).exit_code == 2


def test_the_numbers_are_said_even_if_the_report_cannot_be_written(tmp_path):
    # As on a full disk, which a test cannot have.
    (tmp_path / 'metrics.csv').mkdir()
    run = mvuav('evaluate', 'sim:tanker?frames=3', '-o', tmp_path)
    assert 'frames 3' in run.out.splitlines()
    assert 'metrics.csv is a folder' in run.error

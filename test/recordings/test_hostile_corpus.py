"""Every command over every hostile recording: no traceback, bounded, and no loss without a word."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
import unicodedata
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import Writer
from support import hostile_recordings as made
from support.commands import mvuav
from support.hostile_recordings import CORPUS, EVIL, Known
from support.places import ROOT
from support.recording_samples import TOPIC, image_samples, string_sample, write_mcap

from mvuav_ros.recordings import mcap_file
from mvuav_ros.recordings.reading import open_recording

SLOW = {made.zstd_bomb, made.chunk_bombs, made.many_topics}
MEMORY = 2 << 30
SECONDS = 20
LIMITED = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[1]),) * 2)
resource.setrlimit(resource.RLIMIT_CPU, (int(sys.argv[2]),) * 2)
sys.argv = ['mvuav', *sys.argv[3:]]
from mvuav_ros.cli.app import main
main()
"""


def commands(path: Path, out: Path) -> list[tuple[str, ...]]:
    """What a user would do with it."""
    source = str(path)
    return [
        ('info', source),
        ('repair', source, '-o', f'{out}/repaired.mcap'),
        ('export', source, '-o', f'{out}/tables'),
        ('replay', source, '-o', f'{out}/replayed.mcap', '--nodes', 'marker_tracker'),
        ('evaluate', source, '-o', f'{out}/evaluation'),
    ]


def assert_visible(text: str) -> None:
    """Nothing of it does anything to a terminal."""
    bad = {letter for letter in text if letter != '\n' and unicodedata.category(letter)[0] == 'C'}
    assert not bad, (bad, text)


@pytest.mark.parametrize('make', [m for m in CORPUS if m not in SLOW], ids=lambda m: m.__name__)
def test_nothing_is_lost_without_a_word(make: Callable[[Path], Known], tmp_path: Path) -> None:
    recording = make(tmp_path)
    for command in commands(recording.path, tmp_path / 'out'):
        run = mvuav(*command)  # a traceback would come out as an exception
        assert_visible(run.out + run.err)
        assert 'all is well' not in [line.strip() for line in run.err.splitlines()]
        if run.status:
            assert run.error
    run = mvuav('info', recording.path, '--json')
    if run.status:
        assert recording.kept == 0
        return
    (account,) = json.loads(run.out)['accounts']
    kept = account['kept'] + account['skipped']
    assert recording.kept is None or account['kept'] == recording.kept
    assert recording.written is None or kept + account['lost'] == recording.written
    assert account['is_exact'] or recording.written is None


@pytest.mark.long
@pytest.mark.parametrize('make', CORPUS, ids=lambda m: m.__name__)
def test_no_command_takes_more_than_its_limits(
    make: Callable[[Path], Known], tmp_path: Path
) -> None:
    recording = make(tmp_path)
    for command in commands(recording.path, tmp_path / 'out'):
        jobs = ('--jobs', '1') if command[0] == 'replay' else ()
        environment = {**os.environ, 'PYTHONPATH': str(ROOT), 'OMP_NUM_THREADS': '1'}
        started = time.monotonic()
        done = subprocess.run(
            [sys.executable, '-c', LIMITED, str(MEMORY), str(SECONDS), *command, *jobs],
            env=environment,
            capture_output=True,
            text=True,
            errors='replace',
            timeout=600,
            check=False,
        )
        print(make.__name__, command[0], f'{time.monotonic() - started:.1f} s', done.returncode)
        assert done.returncode in (0, 1) and 'Traceback' not in done.stderr, done.stderr[-2000:]
        assert_visible(done.stdout + done.stderr)


def topics(path: Path) -> dict[str, int]:
    found: dict[str, int] = {}
    with open_recording(path) as recording:
        for message in recording.messages():
            found[message.topic] = found.get(message.topic, 0) + 1
    return found


@pytest.mark.parametrize('make', [made.joined, made.joined_ros1], ids=lambda m: m.__name__)
def test_files_that_were_joined_are_read_to_their_end(
    make: Callable[[Path], Known], tmp_path: Path
) -> None:
    assert topics(make(tmp_path).path) == {TOPIC: 20, '/note': 10}


def test_a_channel_defined_again_means_what_it_says_then(tmp_path: Path) -> None:
    path = made.channel_defined_again(tmp_path).path
    assert topics(path) == {TOPIC: 5, '/note': 5}
    assert 'channel 1 was said to be /camera/image_raw' in mvuav('info', path).err


@pytest.mark.parametrize('make', [made.lying_summary, made.lying_ros1_index])
def test_data_decide_against_the_index(make: Callable[[Path], Known], tmp_path: Path) -> None:
    path = make(tmp_path).path
    assert topics(path) == {TOPIC: 20}
    with open_recording(path) as recording:
        assert [topic.name for topic in recording.topics] == [TOPIC]
        assert any('/forged' in note for note in recording.account.warnings)


def test_times_of_chunks_that_lie_hide_nothing(tmp_path: Path) -> None:
    path = made.lying_times(tmp_path).path
    run = mvuav('replay', path, '-o', tmp_path / 'out.mcap', '--start', '0.5')
    assert run.status == 0 and 'times of chunks are wrong' in run.err
    assert 'results for 14 of 14 frames' in run.out


def test_an_honest_part_is_read_without_unpacking_the_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_mcap(tmp_path / 'a.mcap', image_samples(200), chunk_size=200_000)
    size = path.stat().st_size
    unpacked: list[int] = []
    unpack = mcap_file.unpack

    def counting(*arguments: Any) -> Any:
        result = unpack(*arguments)
        unpacked.append(len(result.data))
        return result

    with open_recording(path) as recording:
        whole = list(recording.messages())
        monkeypatch.setattr(mcap_file, 'unpack', counting)
        monkeypatch.setattr(mcap_file, '_PEEK', 1 << 12)
        part = list(recording.messages(None, whole[-10].stamp_ns))
    assert part == whole[-10:]
    assert sum(unpacked) < size


def test_attachments_metadata_and_times_survive_a_repair(tmp_path: Path) -> None:
    with (tmp_path / 'a.mcap').open('wb') as stream:
        writer = Writer(stream)
        writer.start('ros2', 'test')
        schema = writer.register_schema('std_msgs/msg/String', 'ros2msg', b'string data')
        channel = writer.register_channel('/note', 'cdr', schema)
        writer.add_attachment(5, 6, 'rig.yaml', 'text/yaml', b'markers: []')
        for number in range(5):
            data = string_sample(number).data
            writer.add_message(channel, 1000 + number, data, 900 + number, 70 + number)
        writer.add_metadata('flight', {'pilot': 'somebody'})
        writer.finish()
    assert mvuav('repair', tmp_path / 'a.mcap', '-o', tmp_path / 'b.mcap').err == ''
    with (tmp_path / 'b.mcap').open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        (attachment,) = reader.iter_attachments()
        (metadata,) = reader.iter_metadata()
        messages = [message for _, _, message in reader.iter_messages()]
    assert (attachment.name, attachment.data) == ('rig.yaml', b'markers: []')
    assert (metadata.name, metadata.metadata) == ('flight', {'pilot': 'somebody'})
    times = [(m.log_time, m.publish_time, m.sequence) for m in messages]
    assert times == [(1000 + n, 900 + n, 70 + n) for n in range(5)]


def test_a_huge_attachment_is_no_lost_message(tmp_path: Path) -> None:
    path, header = write_mcap(tmp_path / 'a.mcap', [string_sample(0)]), mcap_file.HEADER
    content, end = path.read_bytes(), len(mcap_file.MAGIC)
    end += header.size + header.unpack_from(content, end)[1]
    size = mcap_file.SIZE_LIMIT + 1
    # Its bytes are a hole in the file, whose footer names no summary.
    footer = bytes(20) + mcap_file.MAGIC
    with path.open('wb') as stream:
        stream.write(content[:end] + header.pack(mcap_file.Opcode.ATTACHMENT, size))
        stream.seek(size, os.SEEK_CUR)
        stream.write(content[end : -len(footer)] + footer)
    with open_recording(path) as recording:
        assert len(list(recording.messages())) == 1
    assert (recording.account.kept, recording.account.errors) == (1, [])


def test_times_before_1970_are_counted_as_altered(tmp_path: Path) -> None:
    path = made.early_times(tmp_path).path
    run = mvuav('repair', path, '-o', tmp_path / 'out.mcap', '--json')
    (account,) = json.loads(run.out)['accounts']
    assert (account['kept'], account['lost'], account['altered']) == (20, 0, 10)
    assert mvuav('repair', path, '-o', tmp_path / 'b.mcap', '--strict').status == 1


def test_what_unpacks_to_much_more_is_limited(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / 'a.mcap', image_samples(700, 64, 48))
    run = mvuav('info', path, '--max-size', '1', '--json')
    (account,) = json.loads(run.out)['accounts']
    assert 200 < account['kept'] < 700 and account['kept'] + account['lost'] == 700
    assert any('--max-size' in error for error in account['errors'])
    assert json.loads(mvuav('info', path, '--json').out)['messages'] == 700
    packed = tmp_path / 'b.mcap.zstd'
    packed.write_bytes(zstandard.ZstdCompressor().compress(path.read_bytes()))
    limited = mvuav('info', packed, '--max-size', '1')
    assert limited.status == 0 and '--max-size allows more' in limited.err
    assert 'unknown number' in limited.err or 'lost' in limited.err


def test_a_table_of_very_many_topics_is_cut(tmp_path: Path) -> None:
    samples = [string_sample(n, f'/t{n}') for n in range(300)]
    path = write_mcap(tmp_path / 'a.mcap', samples)
    lines = mvuav('info', path).out.splitlines()
    assert len(lines) < 210 and lines[-1] == 'and 100 more topics, which --json lists'
    assert len(json.loads(mvuav('info', path, '--json').out)['topics']) == 300
    assert 'and 280 more' in mvuav('replay', path, '-o', tmp_path / 'o.mcap').error


def test_error_lines_and_logs_are_visible(tmp_path: Path) -> None:
    for text in (EVIL, EVIL.encode()[:20] + b'\xff\xfe'):
        name = os.fsdecode(text).replace('/', '').replace('\0', '')
        (tmp_path / name).write_bytes(b'nothing')
        for command in commands(tmp_path / name, tmp_path / 'out'):
            run = mvuav(*command)
            assert run.status == 1 and len(run.err.splitlines()) == 1
            assert_visible(run.err)
    shutil.rmtree(tmp_path / 'out', ignore_errors=True)


def test_only_one_module_of_the_command_line_prints() -> None:
    printing = [
        path.name
        for path in (ROOT / 'mvuav_ros' / 'cli').rglob('*.py')
        if any(word in path.read_text() for word in ('typer.echo(', ' print(', 'secho('))
    ]
    # Two that are read by programs, and one that writes to a terminal by itself.
    assert sorted(printing) == ['app.py', 'live_processes.py', 'terminal.py']

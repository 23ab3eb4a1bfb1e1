"""Sound recordings of every format, cut or flipped anywhere: kept + lost = written.

What can be known: mcap's statistics and ROS 1's chunk infos stand at the file's end, and
metadata.yaml stands beside it. Where one of them is left, the account is exact. Where none is, more
may be lost than anybody can count, and the account says that. A flipped byte within a message is
seen where there is a checksum: not in sqlite3, in ROS 1 but for bz2, and in mcap without chunks, or
with chunks that are not compressed, whose messages are found one by one if their header is hit.
There a kept message may differ, and a length or an id may be another one.
"""

from __future__ import annotations

import json
import random
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from support.commands import mvuav
from support.recording_samples import (
    Sample,
    image_samples,
    pose_sample,
    storage_file,
    string_sample,
    write_mcap,
    write_ros1,
    write_rosbag2,
)

from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.reading import open_recording

TRIALS = 3
"""Of each format and kind of damage."""


class Format(NamedTuple):
    """A way to store; ``checks``: whether a flipped byte of a message can be seen."""

    name: str
    checks: bool


FORMATS = (
    *(Format('zstd.mcap', True), Format('lz4.mcap', True), Format('none.mcap', False)),
    *(Format('unchunked.mcap', False), Format('none.bag', False), Format('bz2.bag', True)),
    *(Format('lz4.bag', False), Format('sqlite3', False), Format('message', False)),
)


def samples(choose: random.Random) -> list[Sample]:
    """A flight of a random length and mixture."""
    count = choose.randrange(8, 40)
    made = [
        *image_samples(count, 32, choose.choice([8, 32, 64])),
        *(string_sample(n) for n in range(choose.randrange(20))),
        *(pose_sample(n) for n in range(choose.randrange(1, 30))),
    ]
    return sorted(made, key=lambda sample: sample.stamp_ns)


def write(folder: Path, kind: Format, written: list[Sample], choose: random.Random) -> Path:
    """The recording: a file, or a folder with metadata.yaml."""
    size = choose.choice([2_000, 10_000, 100_000])
    name, _, suffix = kind.name.partition('.')
    if suffix == 'bag':
        return write_ros1(folder / 'a.bag', written, name, size)
    if suffix == 'mcap':
        compression = 'none' if name == 'unchunked' else name
        chunks = None if name == 'unchunked' else size
        return write_mcap(folder / 'a.mcap', written, compression, chunk_size=chunks)
    mode = 'message' if kind.name == 'message' else 'none'
    return write_rosbag2(folder / 'bag', written, 'sqlite3', mode)


def damage(path: Path, how: str, choose: random.Random) -> None:
    """Cut the file off, flip some bytes, do both, or take a piece out, at random."""
    content = bytearray(path.read_bytes())
    if how == 'holed':
        start = choose.randrange(len(content))
        del content[start : start + choose.choice([1, 50, 500, 3000])]
    if how in ('flipped', 'both'):
        for _ in range(choose.choice([1, 1, 2, 5, 20])):
            content[choose.randrange(len(content))] ^= choose.randrange(1, 256)
    if how in ('cut', 'both'):
        del content[choose.randrange(len(content) // 10, len(content)) :]
    path.write_bytes(content)


def messages(path: Path) -> Counter[Sample]:
    with open_recording(path) as recording:
        return Counter(Sample(*m[:3], bytes(m.data)) for m in recording.messages())


def check(account: dict[str, Any], kept: Counter[Sample], written: list[Sample], kind: Format,
          how: str) -> None:  # fmt: skip
    """The law, as far as the format can tell."""
    total, lost = kept.total(), account['lost']
    assert account['kept'] == total
    if kind.checks or how == 'cut':
        assert kept <= Counter(written), 'a message that nobody wrote'
        assert total == len(written) or account['errors'], 'a loss without a word'
        if account['is_exact']:
            assert total + lost == len(written)
        assert total + lost <= len(written)


EVERY = (
    pytest.mark.parametrize('how', ['cut', 'flipped', 'both']),
    pytest.mark.parametrize('kind', FORMATS, ids=lambda kind: kind.name),
)


@pytest.mark.parametrize('how', ['flipped', 'holed'])
@EVERY[1]
def test_as_many_are_lost_whatever_topics_are_asked_for(
    kind: Format, how: str, tmp_path: Path
) -> None:
    """As `mvuav info` asks for all, and `mvuav export` for those with a table."""
    for seed in range(40):
        choose = random.Random(f'topics {kind.name} {how} {seed}')
        folder = tmp_path / str(seed)
        folder.mkdir()
        path = write(folder, kind, samples(choose), choose)
        damage(storage_file(path) if path.is_dir() else path, how, choose)
        said = set()
        for topics in (None, {'/pose'}, {'/other'}):
            with suppress(RecordingError), open_recording(path) as recording:
                for _ in recording.messages(topics):
                    pass
                said.add((recording.account.lost, recording.account.is_exact))
        assert len(said) < 2, (seed, said)


@EVERY[0]
@EVERY[1]
def test_kept_and_lost_are_what_was_written(kind: Format, how: str, tmp_path: Path) -> None:
    assert_conserved(kind, how, tmp_path, range(TRIALS))


@pytest.mark.long
@EVERY[0]
@EVERY[1]
def test_the_same_many_times(kind: Format, how: str, tmp_path: Path) -> None:
    told, exact = assert_conserved(kind, how, tmp_path, range(100, 140))
    assert told > 10
    if kind.checks and how == 'flipped':
        assert exact > 10


def assert_conserved(kind: Format, how: str, tmp_path: Path, seeds: range) -> tuple[int, int]:
    """How many were read, and of how many the account was exact."""
    exact = told = 0
    for seed in seeds:
        choose = random.Random(f'{kind.name} {how} {seed}')
        written = samples(choose)
        folder = tmp_path / str(seed)
        folder.mkdir()
        path = write(folder, kind, written, choose)
        damage(storage_file(path) if path.is_dir() else path, how, choose)
        runs = {
            'info': mvuav('info', path, '--json'),
            'repair': mvuav('repair', path, '-o', folder / 'repaired.mcap', '--json'),
            'replay': mvuav(
                *('replay', path, '-o', folder / 'replayed.mcap', '--json', '--keep-inputs'),
                *('--nodes', 'marker_tracker'),
            ),
            'export': mvuav('export', path, '-o', folder / 'tables', '--json'),
        }
        if runs['info'].status:
            assert how != 'flipped' or not kind.checks or runs['info'].error
            continue
        told += 1
        accounts = {name: account_of(run.out) for name, run in runs.items() if run.status == 0}
        kept = messages(path)
        for name, account in accounts.items():
            if name != 'export':
                check(account, kept, written, kind, how)
        exact += accounts['info']['is_exact']
        if 'repair' in accounts:
            assert messages(folder / 'repaired.mcap') == kept
        if 'replay' in accounts:
            copied = messages(folder / 'replayed.mcap')
            ours = [s for s in copied if s.topic.startswith('/marker_tracker')]
            assert copied - Counter({s: copied[s] for s in ours}) == kept
        if 'export' in accounts:
            rows = json.loads(runs['export'].out)['files'].values()
            poses = sum(n for sample, n in kept.items() if sample.topic == '/pose')
            failed = accounts['export']['lost'] - accounts['info']['lost']
            assert accounts['export']['kept'] == sum(rows) + failed == poses
    return told, exact


def account_of(text: str) -> dict[str, Any]:
    (account,) = json.loads(text)['accounts']
    return dict(account)

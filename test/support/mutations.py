"""Recordings of every kind, damaged at random but the same for the same seed.

Run as a program it reads such files under a limit of memory and says what it saved of each.
"""

from __future__ import annotations

import json
import random
import resource
import signal
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import NoReturn

from support.recording_samples import (
    image_samples,
    storage_file,
    string_sample,
    write_mcap,
    write_ros1,
    write_rosbag2,
)

MEMORY_LIMIT = 2 << 30
TIME_LIMIT_S = 10
SAMPLES = sorted(
    [*image_samples(30), *(string_sample(number) for number in range(30))],
    key=lambda sample: sample.stamp_ns,
)
SAVED = frozenset((sample.topic, sample.stamp_ns, sample.data) for sample in SAMPLES)

_INTERESTING = (0, 1, 0x7F, 0x80, 0xFF)


def every_kind(folder: Path) -> dict[str, Path]:
    """A sound file of each kind, by its name."""
    files = {
        'zstd.mcap': write_mcap(folder / 'a.mcap', SAMPLES),
        'lz4.mcap': write_mcap(folder / 'b.mcap', SAMPLES, 'lz4'),
        'plain.mcap': write_mcap(folder / 'c.mcap', SAMPLES, 'none'),
        'unindexed.mcap': write_mcap(folder / 'd.mcap', SAMPLES, summary=False),
        'unchunked.mcap': write_mcap(folder / 'e.mcap', SAMPLES, chunk_size=None),
        'none.bag': write_ros1(folder / 'a.bag', SAMPLES),
        'lz4.bag': write_ros1(folder / 'b.bag', SAMPLES, 'lz4'),
        'bz2.bag': write_ros1(folder / 'c.bag', SAMPLES, 'bz2'),
    }
    for storage, suffix in (('sqlite3', 'db3'), ('mcap', 'mcap')):
        for mode in ('none', 'message', 'file'):
            made = write_rosbag2(folder / f'{storage}_{mode}', SAMPLES, storage, mode)
            ending = '.zstd' if mode == 'file' else ''
            files[f'{mode}.{suffix}{ending}'] = storage_file(made)
    return files


def mutated(content: bytes, seed: int) -> bytes:
    """The file with some bytes changed, and perhaps a piece cut out, doubled or moved."""
    choose = random.Random(seed)
    damaged = bytearray(content)
    for _ in range(choose.choice([1, 1, 3, 10, 50])):
        place = choose.randrange(len(damaged))
        if choose.random() < 0.3:  # a length, as far as one can be met by chance
            width = choose.choice([1, 2, 4, 8])
            damaged[place : place + width] = bytes([choose.choice(_INTERESTING)]) * width
        else:
            damaged[place] = choose.randrange(256)
    start, length = choose.randrange(len(damaged)), choose.randrange(1, 5000)
    kind = choose.random()
    if kind < 0.15:
        del damaged[start : start + length]
    elif kind < 0.25:
        damaged[start:start] = damaged[start : start + length]
    elif kind < 0.35:
        del damaged[start:]
    elif kind < 0.4:
        damaged[start : start + length] = bytes(length)
    return bytes(damaged)


def _stuck(_signal: int, _frame: FrameType | None) -> NoReturn:
    raise TimeoutError(f'not done after {TIME_LIMIT_S} s')


def saved_of(path: Path, read: Callable[[Path], set[tuple[str, int, bytes]]]) -> int:
    """How many of the samples are read from a file; an error that is no refusal is raised."""
    signal.setitimer(signal.ITIMER_REAL, TIME_LIMIT_S)
    try:
        return len(read(path) & SAVED)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)


def main(first: int, last: int) -> None:
    """Print the number saved of each kind, summed over the seeds, as JSON."""
    from mvuav_ros.recordings.account import RecordingError
    from mvuav_ros.recordings.reading import open_recording
    from mvuav_ros.recordings.summary import summarise

    def read(path: Path) -> set[tuple[str, int, bytes]]:
        try:
            with open_recording(path) as recording:
                found = {(m.topic, m.stamp_ns, bytes(m.data)) for m in recording.messages()}
                summarise(path)
                return found
        except RecordingError as error:
            assert '\n' not in str(error)
            return set()

    signal.signal(signal.SIGALRM, _stuck)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = {kind: path.read_bytes() for kind, path in every_kind(folder).items()}
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
        saved = dict.fromkeys(files, 0)
        for seed in range(first, last):
            kind = list(files)[seed % len(files)]
            target = folder / f'mutated.{kind}'
            target.write_bytes(mutated(files[kind], seed))
            try:
                saved[kind] += saved_of(target, read)
            except BaseException:
                print(f'seed {seed} of {kind}', file=sys.stderr, flush=True)
                raise
            target.unlink()
    print(json.dumps(saved))


if __name__ == '__main__':
    main(*(int(text) for text in sys.argv[1:]))

"""What the commands write, byte for byte, beside what another version wrote: nothing was lost.

    python tools/golden.py inputs FOLDER               once, with the version before
    python tools/golden.py outputs FOLDER RESULTS.txt [--checkout CHECKOUT] [--only PART]
    python tools/golden.py compare BEFORE.txt AFTER.txt

The inputs are the sample bags, 200 simulated flights, the hostile corpus and 180 damaged recordings
of five formats. The outputs are those of `mvuav replay` (markers by themselves and by the thesis's
program; runway by the thesis's scheme, mode approach and mode road) and, for the damaged ones, of
`mvuav repair` and `mvuav info --json`; each line of a result is an input, a topic and a hash of its
messages in CDR, read with the mcap library. The commands are run as a user runs them, so that the
results compare whatever moves inside the package.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
import os
import random
import runpy
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import make_reader

ROOT = Path(__file__).resolve().parent.parent
MOTIONS = [
    'translation',
    'erratic',
    'roll',
    'roll_translation',
    'roll_360',
    'crossing',
    'docking',
    'still',
]
RUNWAY_MOTIONS = ['approach', 'low_pass', 's_turn']
MODES = {
    'markers': ('tanker', []),
    'markers-thesis': ('tanker/0', ['marker_tracker:prediction:=velocity']),
    'markers-any': ('tanker/0', ['marker_tracker:mode:=track_any']),
    'runway-thesis': ('runway', ['runway_detector:mode:=thesis']),
    'runway-approach': ('runway', ['runway_detector:mode:=approach']),
    'runway-road': (
        'runway/0',
        ['runway_detector:mode:=approach', 'runway_detector:target:=road'],
    ),
}
"""The name of a mode: its flights (a folder, or those whose names begin so) and parameters."""


def command(*arguments: object) -> tuple[int, str]:
    """Run `mvuav …` in this process; its exit status, and what it printed."""
    printed = io.StringIO()
    sys.argv = ['mvuav_ros', 'mvuav', *map(str, arguments)]
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(io.StringIO()):
        try:
            runpy.run_module('mvuav_ros', run_name='__main__', alter_sys=True)
        except SystemExit as end:
            return int(end.code or 0), printed.getvalue()
    return 0, printed.getvalue()


def make_inputs(folder: Path) -> None:
    """Simulate the flights and damage the recordings."""
    sys.path.insert(0, str(ROOT / 'test'))
    from support import hostile_recordings, recording_samples

    choose = random.Random(37)
    for kind in 'tanker', 'runway', 'damaged', 'hostile':
        (folder / kind).mkdir(parents=True, exist_ok=True)
    shutil.copy(ROOT / 'bags' / 'tanker.mcap', folder / 'tanker' / 'sample.mcap')
    shutil.copy(ROOT / 'bags' / 'runway.mcap', folder / 'runway' / 'sample.mcap')
    usual = ['--frames', 50, '--fps', 15, '--force']
    for seed in range(120):
        given = [
            '--seed',
            seed,
            '--motion',
            MOTIONS[seed % 8],
            '--noise',
            choose.choice([0, 1.5, 4]),
        ]
        given += ['--shake', choose.choice([0, 0, 1, 3]), '--glares', choose.choice([0, 0, 2])]
        given += ['--background', choose.choice(['plain', 'sky', 'foam'])]
        given += ['--drop-probability', choose.choice([0, 0, 0.1])]
        given += ['--detail', 0, '--size', choose.choice(['640x480', '320x240'])]
        _made('simulate', 'tanker', '-o', folder / 'tanker' / f'{seed:03}.mcap', *usual, *given)
    for seed in range(80):
        given = ['--seed', seed, '--motion', RUNWAY_MOTIONS[seed % 3], '--size', '320x240']
        given += ['--lateral-offset', choose.uniform(-20, 20)]
        given += ['--runway-width', choose.choice([15, 23, 30, 45])]
        given += ['--camera-pitch-deg', choose.choice([4, 8, 15, 25])]
        given += ['--shake', choose.choice([0, 0, 2]), '--noise', choose.choice([0, 1.5, 4])]
        _made('simulate', 'runway', '-o', folder / 'runway' / f'{seed:03}.mcap', *usual, *given)
    for make in hostile_recordings.CORPUS:
        made = folder / 'hostile' / make.__name__
        made.mkdir(exist_ok=True)
        make(made)
    _damage(folder / 'damaged', recording_samples, choose)


def _damage(folder: Path, samples: Any, choose: random.Random) -> None:
    messages = samples.image_samples(30)
    with tempfile.TemporaryDirectory() as scratch:
        sound = [
            samples.write_mcap(Path(scratch) / 'zstd.mcap', messages),
            samples.write_mcap(Path(scratch) / 'none.mcap', messages, 'none', chunk_size=None),
            samples.storage_file(samples.write_rosbag2(Path(scratch) / 'bag', messages, 'sqlite3')),
            samples.write_ros1(Path(scratch) / 'none.bag', messages, 'none'),
            samples.write_ros1(Path(scratch) / 'lz4.bag', messages, 'lz4'),
        ]
        for number in range(180):
            path = sound[number % len(sound)]
            content = bytearray(path.read_bytes())
            place = choose.randrange(len(content))
            kind = ('cut', 'zeros', 'flips', 'deleted', 'flip')[number // 5 % 5]
            if kind == 'cut':
                del content[place:]
            elif kind == 'zeros':
                content[place:] = bytes(len(content) - place)
            elif kind == 'deleted':
                del content[place : place + choose.randrange(1, 3000)]
            for _ in range({'flips': 30, 'flip': 1}.get(kind, 0)):
                content[choose.randrange(len(content))] ^= 1 << choose.randrange(8)
            (folder / f'{number:03}-{kind}-{path.stem}{path.suffix}').write_bytes(content)


def _made(*arguments: object) -> None:
    status, printed = command(*arguments)
    if status:
        raise SystemExit(f'{" ".join(map(str, arguments))}: {printed}')


def outputs(folder: Path, only: str) -> Iterator[str]:
    """Lines of what this version makes of the inputs."""
    with tempfile.TemporaryDirectory() as scratch:
        made = Path(scratch)
        for mode, (flights, parameters) in MODES.items():
            if only in mode:
                kind, _, start = flights.partition('/')
                node = 'marker_tracker' if kind == 'tanker' else 'runway_detector'
                paths = sorted((folder / kind).glob(f'{start}*.mcap'))
                given = [item for name in parameters for item in ('--param', name)]
                out = made / mode
                replay = ['replay', *paths, '-o', out, '--nodes', node, '--jobs', 1, *given]
                status, _ = command(*replay)
                yield f'{mode} status {status}'
                for path in sorted(out.glob('*.mcap')):
                    yield from messages(f'{mode} {path.stem}', path)
        damaged = [*sorted((folder / 'damaged').iterdir())]
        damaged += [
            path
            for path in sorted((folder / 'hostile').glob('*/*'))
            if path.name != 'metadata.yaml'
        ]
        for number, path in enumerate(damaged):
            name = f'damaged {path.relative_to(folder)}'
            if only in name:
                mended = made / f'{number}.mcap'
                status, _ = command('repair', path, '-o', mended)
                yield f'{name} repair {status}'
                if mended.exists():
                    yield from messages(name, mended)
                status, printed = command('info', path, '--json')
                printed = printed.replace(str(folder), '')
                yield f'{name} info {status} {hashlib.sha256(printed.encode()).hexdigest()[:16]}'


def messages(name: str, path: Path) -> Iterator[str]:
    """A line for each topic of a bag."""
    hashes: dict[str, hashlib._Hash] = {}
    counts: dict[str, int] = {}
    with path.open('rb') as stream, contextlib.suppress(McapError):
        for schema, channel, message in make_reader(stream).iter_messages():
            topic = f'{channel.topic} {schema.name if schema else ""}'
            hashes.setdefault(topic, hashlib.sha256()).update(
                message.log_time.to_bytes(8, 'little')
            )
            hashes[topic].update(message.data)
            counts[topic] = counts.get(topic, 0) + 1
    if len(hashes) > 50:
        whole = hashlib.sha256(
            ''.join(f'{t}{hashes[t].hexdigest()}' for t in sorted(hashes)).encode()
        )
        hashes, counts = {'all': whole}, {'all': sum(counts.values())}
    for topic in sorted(hashes):
        yield f'{name} {topic!a} {counts[topic]} {hashes[topic].hexdigest()[:16]}'


def compare(before: Path, after: Path) -> int:
    """Print the lines that differ; how many."""
    old, new = (dict.fromkeys(path.read_text().splitlines()) for path in (before, after))
    different = [f'- {line}' for line in old if line not in new]
    different += [f'+ {line}' for line in new if line not in old]
    print(*sorted(different, key=lambda line: line[2:]), sep='\n')
    print(f'{len(different)} lines differ, {len(old)} before, {len(new)} after')
    return len(different)


def main() -> None:
    """Run one of the three actions."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('action', choices=['inputs', 'outputs', 'compare'])
    parser.add_argument('first', type=Path)
    parser.add_argument('second', type=Path, nargs='?')
    parser.add_argument('--checkout', type=Path, default=ROOT)
    parser.add_argument('--only', default='', help='part of a name: markers, runway-road, damaged')
    given = parser.parse_args()
    if given.action == 'compare':
        raise SystemExit(min(compare(given.first, given.second), 1))
    if os.environ.get('PYTHONPATH') != str(given.checkout.resolve()):
        environment = {**os.environ, 'PYTHONPATH': str(given.checkout.resolve())}
        raise SystemExit(subprocess.call([sys.executable, *sys.argv], env=environment))
    if given.action == 'inputs':
        make_inputs(given.first)
    else:
        with given.second.open('w') as results:
            for line in outputs(given.first, given.only):
                print(line, file=results, flush=True)
        print(json.dumps({'lines': sum(1 for _ in given.second.open())}))


if __name__ == '__main__':
    main()

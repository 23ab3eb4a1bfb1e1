"""What each mechanism of mode approach is for: the evaluation with it switched off, one by one.

    python tools/ablate_approach.py ../shared/footage OUT [--only NAME ...]

Prints a table for docs/decisions/approach-mechanisms.md. OUT keeps a JSON file for each mechanism;
what is there stays as it is. What chance does is measured as well: nothing is switched off, but
every image has noise of up to one grey level.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from approach_mechanisms import WITHOUT
from approach_rows import Frame, Row

FULL = 'nothing'
NOISE = 'nothing, noise '
ROWS = (
    'run2 colour image',
    'run2 grey horizon cut',
    'run3 colour image',
    'run5 grey image',
    'solidWhiteRight colour',
    '720p colour OSD',
    '720p colour boxes',
    'threshold_64 colour boxes',
    'simulated approach',
    'simulated S-turn',
    'simulated noise',
    'simulated bank 30',
    'looking down, pitch 33',
    'looking down, slabs, pitch 29, shaken, grey',
    'over the runway, slabs, low',
)
"""Parts of the names of the rows that are compared, unless others are asked for."""
SKIPPED = 'attitude'
"""The same of what is left out of these."""
CHANGED = 2.0
"""Percent of a row's frames beyond what noise does: fewer are noise, too."""
NOISES = 3
"""Runs with noise."""


def evaluated(options: argparse.Namespace, name: str) -> list[Row]:
    """The rows without a mechanism, in a process of its own."""
    path = options.folder / f'{name.replace(" ", "_")}.json'
    if not path.exists():
        part = path.with_suffix('.part')
        command = [sys.executable, str(Path(__file__).with_name('evaluate_approach.py'))]
        command += [str(options.footage), '--only', *options.rows, '--skip', SKIPPED]
        command += ['--json', str(part), '--cache', str(options.folder / 'frames')]
        if name.startswith(NOISE):
            command += ['--noise', name.removeprefix(NOISE)]
        elif name != FULL:
            command += ['--without', name]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        part.rename(path)
    return [
        Row(**{**entry, 'frames': [Frame(**frame) for frame in entry['frames']]})
        for entry in json.loads(path.read_text())
    ]


def table(rows: list[Row], unchanged: list[list[Row]]) -> Iterator[str]:
    """Cells: right and wrong on both halves, and rows that are better and worse than by chance."""
    gains = np.array([[gain(row) for row in run] for run in unchanged])
    now = np.array([gain(row) for row in rows])
    better = now > gains.max(axis=0) + CHANGED
    worse = now < gains.min(axis=0) - CHANGED
    for check in (False, True):
        part = np.array([row.check == check for row in rows])
        if not part.any():
            yield from ('', '', '')
            continue
        shares = np.array([row.shares()[1:] for row in rows if row.check == check])
        right, wrong = shares.mean(axis=0)
        yield f'{right:.1f} %'
        yield f'{wrong:.1f} %'
        yield f'{(better & part).sum()}, {(worse & part).sum()} of {part.sum()}'


def gain(row: Row) -> float:
    """Right frames minus wrong ones, percent."""
    _, right, wrong = row.shares()
    return right - wrong


def main() -> None:
    """Print the table, a line for each mechanism."""
    parser = argparse.ArgumentParser()
    parser.add_argument('footage', type=Path)
    parser.add_argument('folder', type=Path)
    parser.add_argument('--only', nargs='*', choices=WITHOUT, help='mechanisms; all if missing')
    parser.add_argument('--rows', nargs='*', default=ROWS, help='parts of their names')
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    controls = (FULL, *(f'{NOISE}{seed}' for seed in range(1, NOISES + 1)))
    unchanged = [evaluated(options, name) for name in controls]
    titles = ('right', 'wrong', 'better, worse')
    print('| without | ms |', ' | '.join(f'{t} ({h})' for h in ('tuned', 'check') for t in titles))
    print('|' + '---|' * 8)
    for name in (*controls, *(WITHOUT if options.only is None else options.only)):
        rows = evaluated(options, name)
        spent = math.fsum(row.later_ms for row in rows) / len(rows)
        print(f'| {name} | {spent:.1f} |', ' | '.join(table(rows, unchanged)), '|', flush=True)


if __name__ == '__main__':
    main()

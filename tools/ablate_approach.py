"""What each mechanism of mode approach is for: the evaluation with it switched off, one by one.

    python tools/ablate_approach.py ../shared/footage OUT [--only NAME ...]

Prints a table for docs/runway.md. OUT keeps a JSON file for each mechanism; what is there stays
as it is.
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
KINDS = ('runs', 'no horizon', 'simulated')
ROWS = ('run2 colour image', 'run3 colour image', 'run5 grey image', 'simulated S-turn, attitude')
"""Parts of the names of the rows that are compared, unless others are asked for."""
CHANGED = 2.0
"""Percent of a row's frames: fewer are noise."""


def evaluated(options: argparse.Namespace, name: str) -> list[Row]:
    """The rows without a mechanism, in a process of its own."""
    path = options.folder / f'{name.replace(" ", "_")}.json'
    if not path.exists():
        part = path.with_suffix('.part')
        command = [sys.executable, str(Path(__file__).with_name('evaluate_approach.py'))]
        command += [str(options.footage), '--kinds', *options.kinds, '--only', *options.rows]
        command += ['--json', str(part), '--cache', str(options.folder / 'frames')]
        if name != FULL:
            command += ['--without', name]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        part.rename(path)
    return [
        Row(**{**entry, 'frames': [Frame(**frame) for frame in entry['frames']]})
        for entry in json.loads(path.read_text())
    ]


def table(rows: list[Row], full: list[Row]) -> Iterator[str]:
    """Cells: right and wrong on both halves, and rows that are better and worse."""
    for check in (False, True):
        part = [(one, other) for one, other in zip(rows, full, strict=True) if one.check == check]
        shares = np.array([one.shares()[1:] for one, _ in part])
        change = shares - np.array([other.shares()[1:] for _, other in part])
        # Roads have no right frames.
        gain = np.where(np.abs(change) > CHANGED, change, 0.0) @ (1.0, -1.0)
        right, wrong = shares.mean(axis=0)
        yield f'{right:.1f} %'
        yield f'{wrong:.1f} %'
        yield f'{(gain > 0).sum()}, {(gain < 0).sum()} of {len(part)}'


def main() -> None:
    """Print the table, a line for each mechanism."""
    parser = argparse.ArgumentParser()
    parser.add_argument('footage', type=Path)
    parser.add_argument('folder', type=Path)
    parser.add_argument('--only', nargs='*', choices=WITHOUT, help='mechanisms; all if missing')
    parser.add_argument('--kinds', nargs='*', default=KINDS, help='as of evaluate_approach.py')
    parser.add_argument('--rows', nargs='*', default=ROWS, help='parts of their names')
    options = parser.parse_args()
    full = evaluated(options, FULL)
    titles = ('right', 'wrong', 'better, worse')
    print('| without | ms |', ' | '.join(f'{t} ({h})' for h in ('tuned', 'check') for t in titles))
    print('|' + '---|' * 8)
    for name in (FULL, *(WITHOUT if options.only is None else options.only)):
        rows = evaluated(options, name)
        spent = math.fsum(row.later_ms for row in rows) / len(rows)
        print(f'| {name} | {spent:.1f} |', ' | '.join(table(rows, full)), '|', flush=True)


if __name__ == '__main__':
    main()

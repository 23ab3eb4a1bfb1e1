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
ROWS = (
    'run2 colour image', 'run3 colour image', 'run5 grey image', 'rural_road_720 colour',
    'simulated S-turn, attitude', 'simulated noise', 'simulated pitch 26, attitude',
    'simulated pitch 32, shaken, attitude', 'simulated bank 20',
)  # fmt: skip
"""Parts of the names of the rows that are compared."""
KINDS = ('runs', 'no horizon', 'roads', 'simulated')
IN_STILLS = (
    FULL, 'overlays', 'horizon in the image', 'coarsest level', 'edges in paint', 'third track',
)  # fmt: skip
"""What tells in the first frames already: the cockpit stills are counted as well."""
CHANGED = 2.0
"""Percent of a row's frames: fewer are noise."""


def evaluated(footage: Path, folder: Path, name: str) -> list[Row]:
    """The rows without a mechanism, in a process of its own."""
    path = folder / f'{name.replace(" ", "_")}.json'
    if not path.exists():
        part = path.with_suffix('.part')
        command = [sys.executable, str(Path(__file__).with_name('evaluate_approach.py'))]
        stills = ('stills',) if name in IN_STILLS else ()
        command += [str(footage), '--kinds', *KINDS, *stills, '--only', *ROWS, *stills]
        command += ['--json', str(part)]
        command += ['--clip-step', '8', '--still-frames', '8', '--cache', str(folder / 'frames')]
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
    parser.add_argument('--only', nargs='*', choices=WITHOUT)
    options = parser.parse_args()
    full = evaluated(options.footage, options.folder, FULL)
    titles = ('right', 'wrong', 'better, worse')
    print('| without | ms |', ' | '.join(f'{t} ({h})' for h in ('tuned', 'check') for t in titles))
    print('|' + '---|' * 8)
    for name in (FULL, *(WITHOUT if options.only is None else options.only)):
        rows = evaluated(options.footage, options.folder, name)
        spent = math.fsum(row.later_ms for row in rows) / len(rows)
        print(f'| {name} | {spent:.1f} |', ' | '.join(table(rows, full)), '|', flush=True)


if __name__ == '__main__':
    main()

"""What each mechanism of naming is for: the flights with it switched off, one by one.

    python tools/ablate_markers.py OUT [--seeds 52000 52009] [--only NAME ...]

Names with commas between them are switched off together. OUT keeps a file for each flight seed and
mechanism; what is there stays as it is.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from compare_markers import ROOT, Version
from marker_mechanisms import WITHOUT

FULL = 'nothing'
Flights = dict[tuple[str, int], dict[str, Any]]


def flown(folder: Path, name: str, seed: int) -> Flights:
    """One flight of every group without a mechanism, in a process of its own."""
    path = folder / f'{name.replace(" ", "_")}-{seed}.json'
    if not path.exists():
        version = Version(ROOT, '' if name == FULL else name)
        figures = {group: version.fly(group, seed) for group in version.groups}
        version.close()
        path.write_text(json.dumps(figures))
    return {(group, seed): row for group, row in json.loads(path.read_text()).items()}


def line(name: str, flights: Flights, full: Flights) -> Iterator[str]:
    """Cells: wrong, missed, frames waited; flights with fewer and more wrong; the worst groups."""
    yield name
    rows = [(flights[key], full[key]) for key in flights]
    yield f'{sum(row["wrong"] for row, _ in rows)} ({sum(row["wrong"] for _, row in rows)})'
    missed = [
        100 * sum(row['missed'] for row in part) / sum(row['whole'] for row in part)
        for part in zip(*rows, strict=True)
    ]
    yield f'{missed[0]:.2f} ({missed[1]:.2f}) %'
    yield f'{sum(sum(row["waits"]) for row, _ in rows)} ({sum(sum(r["waits"]) for _, r in rows)})'
    change = [row['wrong'] - other['wrong'] for row, other in rows]
    yield f'{sum(c < 0 for c in change)}, {sum(c > 0 for c in change)}'
    groups = list(dict.fromkeys(group for group, _ in flights))
    told = []
    for group in groups:
        pairs = [(flights[key], full[key]) for key in flights if key[0] == group]
        wrong = sum(row['wrong'] - other['wrong'] for row, other in pairs)
        whole = sum(row['whole'] for row, _ in pairs)
        lost = 100 * sum(row['missed'] - other['missed'] for row, other in pairs) / max(whole, 1)
        if wrong or abs(lost) > 0.3:
            told.append(f'{group} {wrong:+d} {lost:+.1f}%')
    yield '; '.join(told)


def main() -> None:
    """Fly round after round of seeds; a line for each mechanism after each round."""
    parser = argparse.ArgumentParser()
    parser.add_argument('folder', type=Path)
    parser.add_argument('--seeds', type=int, nargs=2, default=(52000, 52009))
    parser.add_argument('--only', nargs='*')
    parser.add_argument('--step', type=int, default=3)
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    print('| without | wrong | missed | waited | flights better, worse | groups |\n|' + '---|' * 6)
    names = list(WITHOUT) if options.only is None else options.only
    first, last = options.seeds
    for begin in range(first, last, options.step):
        seeds = range(first, min(begin + options.step, last))
        full: Flights = {}
        for name in (FULL, *names):
            flights: Flights = {}
            for seed in seeds:
                flights |= flown(options.folder, name, seed)
            full = full or flights
            print('|', ' | '.join(line(name, flights, full)), '|', flush=True)


if __name__ == '__main__':
    main()

"""Measured figures: the documentation's pages take them from docs/figures by name.

    python tools/figures.py markers FILE [NAME]   what tools/compare_markers.py --json wrote
    python tools/figures.py approach FILE [NAME]  what tools/evaluate_approach.py --json wrote
    python tools/figures.py speed FILE...         what mvuav bench --json wrote
    python tools/figures.py write                 put the figures of docs/figures into the pages
    python tools/figures.py check                 what differs, and which numbers nobody stated
    python tools/figures.py list                  every number with a unit, and its source
    python tools/figures.py state                 state the pages' other numbers: stated.txt

Each evaluation has a file docs/figures/EVALUATION.json: the command, the data, the version and the
date; `figures` with a value, a unit and the text for the page; `tables` of such texts. On a page

    <!-- figure: markers.wrong -->9<!-- /figure -->        is a figure's text,
    <!-- table: markers.kept_back --> … <!-- /table -->    is a table.

NAME is the version that was measured: of `markers` one of those in the file, else the checkout's
unless it is given. `write` renews the pages. A number with a unit that is neither a figure nor in a
table is not measured: a limit, a constant, the thesis's, or an example's. Those stand in
docs/figures/stated.txt, a line for each page, so that a new one is looked at before `state` takes
it in.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from datetime import date
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / 'docs' / 'figures'
STATED = DATA / 'stated.txt'
_FIGURE = re.compile(r'<!-- figure: (\S+) -->(.*?)<!-- /figure -->', re.S)
_TABLE = re.compile(r'<!-- table: (\S+) -->\n(.*?)<!-- /table -->', re.S)
_CODE = re.compile(r'^( *)```.*?^\1```|`[^`\n]*`|\]\([^)\s]*\)|^#.*?$', re.S | re.M)
_UNIT = (
    r'%|px/s|px|ms|µs|°|deg|MB|kB|GB|MiB|KiB|s|m/s|mm|nm|m|Hz|frames/s|marker-frames|frames|flights'
)
_NUMBER = re.compile(rf'(?<![\w.,-])(\d[\d,]*(?:\.\d+)?) ?({_UNIT})(?![\w/])')
_GENERATED = ('reference/', 'figures/', 'developers/', 'decisions/')


def pages() -> list[Path]:
    """README and the pages that are written by hand."""
    written = (
        path
        for path in sorted((ROOT / 'docs').rglob('*.md'))
        if not str(path.relative_to(ROOT / 'docs')).startswith(_GENERATED)
    )
    return [ROOT / 'README.md', *written]


def load() -> dict[str, Any]:
    """All evaluations by name."""
    return {path.stem: json.loads(path.read_text()) for path in sorted(DATA.glob('*.json'))}


def figure(value: float | str, unit: str = '', digits: int | None = None) -> dict[str, Any]:
    """A value, its unit, and the text for a page."""
    shown = f'{value:,}' if digits is None else f'{value:,.{digits}f}'
    between = '' if unit in ('', '°') else ' '
    return {'value': value, 'unit': unit, 'text': f'{shown}{between}{unit}'}


def table(columns: list[str], rows: list[list[str]]) -> dict[str, Any]:
    """A table as it is on a page."""
    return {'columns': columns, 'rows': rows}


def render(content: dict[str, Any]) -> str:
    """A table in Markdown."""
    rows = [f'| {" | ".join(row)} |\n' for row in (content['columns'], *content['rows'])]
    return ''.join([rows[0], '|' + '---|' * len(content['columns']) + '\n', *rows[1:]])


def renewed(text: str, data: dict[str, Any]) -> str:
    """A page with the figures of the data.

    Raises:
        KeyError: the page names a figure or a table that is not in the data.
    """

    def one(kind: str, name: str) -> Any:
        evaluation, _, rest = name.partition('.')
        return data[evaluation][kind][rest]

    text = _FIGURE.sub(
        lambda m: f'<!-- figure: {m[1]} -->{one("figures", m[1])["text"]}<!-- /figure -->', text
    )
    return _TABLE.sub(
        lambda m: f'<!-- table: {m[1]} -->\n{render(one("tables", m[1]))}<!-- /table -->', text
    )


def numbers(text: str) -> Iterator[tuple[int, str, str]]:
    """Line, number with its unit, and where it comes from; '' where from nothing measured."""
    spans = [(m.start(), m.end(), m[1]) for kind in (_FIGURE, _TABLE) for m in kind.finditer(text)]
    code = [m.span() for m in _CODE.finditer(text)]
    for match in _NUMBER.finditer(text):
        place = match.start()
        if any(begin <= place < end for begin, end in code):
            continue
        name = next((name for begin, end, name in spans if begin <= place < end), '')
        unit = match[2]
        shown = match[1] + ('' if unit == '°' else ' ') + unit
        yield text.count('\n', 0, place) + 1, shown, name


def unmeasured(text: str) -> Counter[str]:
    """How often each number with a unit stands on a page without being a figure of the data."""
    return Counter(shown for _, shown, name in numbers(text) if not name)


def read_stated() -> dict[str, Counter[str]]:
    """The numbers of each page that are no measurements."""
    stated = {}
    for line in STATED.read_text().splitlines() if STATED.exists() else ():
        page, _, rest = line.partition(': ')
        counts = (item.rpartition(' x') for item in rest.split('; ') if item)
        stated[page] = Counter({shown: int(count) for shown, _, count in counts})
    return stated


def write_stated(found: dict[str, Counter[str]]) -> None:
    """One line for each page."""
    lines = (
        f'{page}: ' + '; '.join(f'{shown} x{count}' for shown, count in sorted(counts.items()))
        for page, counts in found.items()
        if counts
    )
    STATED.write_text('\n'.join(lines) + '\n')


def problems() -> list[str]:
    """Figures that differ from the data, and numbers that nobody has stated."""
    data, stated, found = load(), read_stated(), []
    for path in pages():
        name, text = str(path.relative_to(ROOT)), path.read_text()
        try:
            if renewed(text, data) != text:
                found.append(
                    f'{name}: figures differ from docs/figures; run tools/figures.py write'
                )
        except KeyError as error:
            found.append(f'{name}: no figure {error} in docs/figures')
        here, known = unmeasured(text), stated.get(name, Counter())
        found += [f'{name}: {shown} is neither measured nor stated' for shown in here - known]
        found += [f'{name}: {shown} is stated, but not there' for shown in known - here]
    return found


def markers(path: Path, name: str = '') -> None:
    """Names and poses of the flights that were kept back."""
    kept = json.loads(path.read_text())
    name = name or next(key for key in reversed(kept) if kept[key]['seeds'][0] >= 30000)
    groups = {key: row for key, row in kept[name]['groups'].items() if key != 'all'}
    rows = [
        [
            group,
            f'{row["flights"]}; {row["frames"]:,}',
            f'{row["wrong"]}; {row["longest_wrong"]}',
            f'{row["missed_percent"]:.1f} %',
            f'{row["waits"]}; {row["longest_wait"]}',
            _percent(row['roll_percent']),
            _percent(row['pose_percent'] or None),
            f'{row["worst_moved_percent"]:.2f} %, {row["worst_turned_deg"]:.2f}°'
            if row['pose_percent']
            else '-',
        ]
        for group, row in groups.items()
    ]
    columns = ['flights', 'flown; frames', 'wrong; longest run', 'missed']
    columns += ['waits; longest', 'roll told', 'pose', 'worst pose']
    seeds = kept[name]['seeds']
    sums = {
        'all': list(groups),
        'calibrated': [g for g in groups if g.startswith('package: ') and 'markers at' not in g],
        'uncalibrated': [g for g in groups if g.startswith('package, no') and 'eight' not in g],
        'hostile': ['everything at once'],
        'three': ['three lights'],
        'four': ['four lights'],
        'eight': ['eight lights'],
    }
    figures = {
        f'{part}.{key}': value
        for part, chosen in sums.items()
        for key, value in _totals(
            [groups[group] for group in chosen],
            [next((n for word, n in _LIGHTS.items() if word in g), 5) for g in chosen],
        ).items()
    }
    _record(
        'markers',
        f'tools/compare_markers.py --flights {kept[name]["flights"]} --seeds {seeds[0]} {seeds[1]}',
        f'simulated flights of seeds {seeds[0]} and on, kept back; {len(groups)} kinds of flights',
        figures,
        {'kept_back': table(columns, rows)},
        version=name,
    )


def _percent(value: float | None) -> str:
    return '-' if value is None else f'{value:.0f} %'


_LIGHTS = {'three': 3, 'four': 4, 'eight': 8}


def _totals(rows: list[dict[str, Any]], counts: list[int]) -> dict[str, Any]:
    """Sums of some kinds of flights whose rigs have so many lights."""
    frames = sum(row['frames'] for row in rows)
    found = {
        'flights': figure(sum(row['flights'] for row in rows), 'flights'),
        'frames': figure(frames, 'frames'),
        'wrong': figure(sum(row['wrong'] for row in rows)),
        'run': figure(max(row['longest_wrong'] for row in rows), 'frames'),
        'missed': figure(
            round(sum(row['missed_percent'] * row['frames'] for row in rows) / frames, 1), '%', 1
        ),
        'wait': figure(max(row['longest_wait'] for row in rows), 'frames'),
    }
    lights = sum(row['frames'] * count for row, count in zip(rows, counts, strict=True))
    found['per_100000'] = figure(round(1e5 * sum(row['wrong'] for row in rows) / lights))
    posed = [row for row in rows if row['pose_percent']]
    if posed:
        share = sum(row['pose_percent'] * row['frames'] for row in posed)
        share /= sum(row['frames'] for row in posed)
        found['pose'] = figure(round(share), '%', 0)
        found['moved'] = figure(max(row['worst_moved_percent'] for row in posed), '%', 2)
    return found


def approach(path: Path, version: str = '') -> None:
    """Shares of right and wrong frames of mode approach."""
    from approach_rows import Frame, Row

    rows = [
        Row(**{**entry, 'frames': [Frame(**frame) for frame in entry['frames']]})
        for entry in json.loads(path.read_text())
    ]
    shown: dict[str, list[list[str]]] = {}
    figures: dict[str, Any] = {}
    for row in rows:
        reported, right, wrong = row.shares()
        count = len(row.frames[row.warm_up :])
        cells = [row.name.strip(), 'check' if row.check else 'tuned', f'{count:,}']
        cells += [
            f'{right:.1f} %',
            f'{wrong:.1f} %',
            f'{row.first or "-"}',
            f'{row.later_ms:.1f} ms',
        ]
        shown.setdefault(row.kind.replace(' ', '_'), []).append(cells)
        key = re.sub(r'\W+', '_', row.name.strip())
        figures[f'{key}.right'] = figure(round(right, 1), '%', 1)
        figures[f'{key}.wrong'] = figure(round(wrong, 1), '%', 1)
        figures[f'{key}.reported'] = figure(round(reported, 1), '%', 1)
    columns = ['footage', 'half', 'frames', 'right', 'wrong', 'first report', 'time a frame']
    for kind in {row.kind for row in rows}:
        for half in (False, True):
            part = [row for row in rows if row.kind == kind and row.check == half]
            if part:
                name = f'{kind.replace(" ", "_")}.{"check" if half else "tuned"}'
                shares = [row.shares() for row in part]
                frames = [len(row.frames[row.warm_up :]) for row in part]
                times = [row.later_ms for row in part]
                figures[f'{name}.frames'] = figure(sum(frames), 'frames')
                least, most = min(s[1] for s in shares), max(s[2] for s in shares)
                figures[f'{name}.right_least'] = figure(round(least, 1), '%', 1)
                figures[f'{name}.wrong_most'] = figure(round(most, 1), '%', 1)
                figures[f'{name}.ms_least'] = figure(round(min(times), 1), 'ms', 1)
                figures[f'{name}.ms_most'] = figure(round(max(times), 1), 'ms', 1)
    _record(
        'approach',
        'tools/evaluate_approach.py FOOTAGE --json FILE',
        'real approaches, roads and fields by flights, and simulated flights',
        figures,
        {kind: table(columns, cells) for kind, cells in shown.items()},
        version=version,
    )


def speed(*paths: Path) -> None:
    """Times of mvuav bench and mvuav bench live."""
    cases = [case for path in paths for case in json.loads(path.read_text())]
    timed = [case for case in cases if 'median_ms' in case]
    columns = ['case', 'median', 'compared with', 'ratio']
    rows = [
        [
            case['case'],
            f'{case["median_ms"]:.2f} ms',
            f'{case["baseline"]}, {case["baseline_ms"]:.2f} ms' if case['baseline_ms'] else '-',
            f'{case["ratio"]:.1f}' if case['ratio'] else '-',
        ]
        for case in timed
    ]
    figures = {
        re.sub(r'\W+', '_', case['case']).strip('_'): figure(round(case['median_ms'], 2), 'ms', 2)
        for case in timed
    }
    tables = {'frame': table(columns, rows)} if rows else {}
    _record('speed', 'mvuav bench --json FILE', 'one machine of two cores', figures, tables)


def _record(
    name: str,
    command: str,
    data: str,
    figures: dict[str, Any],
    tables: dict[str, Any],
    version: str = '',
) -> None:
    commit = subprocess.run(
        ['git', 'describe', '--always'], cwd=ROOT, capture_output=True, text=True
    ).stdout.strip()
    old = load().get(name, {})
    measured = {'version': version or commit, 'date': date.today().isoformat()}
    tables = {key: {**content, **measured} for key, content in tables.items()}
    content = {
        'command': command,
        'data': data,
        **measured,
        # What this run did not measure keeps its place.
        'figures': {**old.get('figures', {}), **figures},
        'tables': {**old.get('tables', {}), **tables},
    }
    (DATA / f'{name}.json').write_text(json.dumps(content, indent=1, ensure_ascii=False) + '\n')


def main() -> None:
    """Run what was asked for."""
    action, *rest = sys.argv[1:] or ['']
    if action == 'markers' and rest:
        markers(Path(rest[0]), *rest[1:2])
    elif action == 'approach' and rest:
        approach(Path(rest[0]), *rest[1:2])
    elif action == 'speed' and rest:
        speed(*map(Path, rest))
    elif action == 'write':
        data = load()
        for path in pages():
            path.write_text(renewed(path.read_text(), data))
    elif action == 'state':
        write_stated({str(p.relative_to(ROOT)): unmeasured(p.read_text()) for p in pages()})
    elif action == 'list':
        for path in pages():
            for line, shown, name in numbers(path.read_text()):
                print(f'{path.relative_to(ROOT)}:{line}\t{shown}\t{name or "stated"}')
    elif action == 'check':
        found = problems()
        print('\n'.join(found) or 'every measured figure is that of docs/figures')
        sys.exit(bool(found))
    else:
        sys.exit(__doc__)


if __name__ == '__main__':
    main()

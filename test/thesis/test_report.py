"""The whole report, twice: what it says must follow from its own numbers, whatever the seed."""

import csv
import json
import math
import re
from html import unescape

import cv2
import numpy as np
import pytest

from mvuav_ros.offline.report import render_page, write_report
from mvuav_thesis import known
from mvuav_thesis.build import build_report, steps_of
from mvuav_thesis.comparison import compared_cells
from mvuav_thesis.plan import Plan

pytestmark = pytest.mark.long

TABLES = {
    'claims',
    'worse_method',
    'worse_shipped',
    *(f'table_5_{number}' for number in range(1, 8)),
    'table_5_3_ratio',
    'table_5_3_vibration',
    'table_5_3_truth_found',
    'table_5_3_truth_predicted',
    'table_5_5_truth',
    'table_5_5_noise',
    'figures_5_1_to_5_3',
    'figure_4_30',
    'runway_flags',
    'runway_truth',
    'approach',
    'integrity',
    'names',
    'pose',
    'prediction_by_motion',
}
FIGURES = {f'figure_5_{number}' for number in range(1, 16)} | {'figure_appendix_c'}
PRINTED_IN = {'figures': 'figures_5_1_to_5_3'}


def small_plan(seed):
    return Plan(
        seed=seed,
        jobs=1,
        trial_seconds=1.6,
        trial_repeats=2,
        prediction_flights=1,
        passes=1,
        repeats=1,
        measurements=5,
        runway_seconds=1.2,
        identity_scenes=1,
        integrity_scenes=2,
        integrity_repeats=1,
        pose_frames=60,
    )


@pytest.fixture(scope='module', params=[5, 77])
def written(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp('thesis')
    steps = []
    plan = small_plan(request.param)
    report, _ = build_report(plan, lambda: steps.append(1), f'evaluate --seed {plan.seed}')
    assert len(steps) == steps_of(plan)
    write_report(report, folder)
    return report, folder


@pytest.fixture(scope='module')
def tables(written):
    return {table.key: table for table in written[0].tables()}


@pytest.fixture(scope='module')
def said(written):
    """The page's words without its tags."""
    page = (written[1] / 'index.html').read_text()
    return re.sub(r'\s+', ' ', unescape(re.sub(r'<[^>]+>', ' ', page)))


def values(table, *words):
    """The numbers of the rows that begin with these words."""
    return [
        [getattr(cell, 'value', cell) for cell in row[len(words) :]]
        for row in table.rows
        if all(a == b or b is None for a, b in zip(row, words, strict=False))
    ]


def test_every_table_and_figure_is_there(written):
    report, folder = written
    assert {table.key for table in report.tables()} == TABLES
    assert {figure.key for figure in report.figures()} == FIGURES
    for key in TABLES:
        with (folder / f'{key}.csv').open() as stream:
            rows = list(csv.reader(stream))
        records = json.loads((folder / f'{key}.json').read_text())
        assert len(rows) == len(records) + 1 > 1
        assert rows[0] == list(records[0])
    for key in FIGURES:
        image = cv2.imread(str(folder / f'{key}.png'))
        assert image.shape[1] == 1440
        assert np.std(image) > 5


def test_the_page_needs_nothing_else(written):
    page = (written[1] / 'index.html').read_text()
    sources = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert len(sources) > len(FIGURES)
    assert all(s.startswith(('data:image/png;base64,', '#')) for s in sources)
    assert not re.search(r'<script|<link|@import|url\(|https?://', page)


def test_the_page_says_what_made_it(written):
    report, folder = written
    settings = json.loads((folder / 'report.json').read_text())['settings']
    assert settings['command'] == f'evaluate --seed {settings["seed"]}'
    assert 'prediction=acceleration_program' in settings['marker_tracker as in the thesis']
    assert 'start_row=49' in settings['runway_detector as in the thesis']
    assert settings['version'] in render_page(report)


def test_every_number_of_the_thesis_is_printed_in_its_table(tables, said):
    assert len(known.ALL) == 148
    for cell in known.ALL:
        texts = [
            text
            for row in tables[PRINTED_IN.get(cell.table, cell.table)].rows
            for text in row
            if isinstance(text, str)
        ]
        same = [
            other for other in known.ALL if (other.table, other.text) == (cell.table, cell.text)
        ]
        assert texts.count(cell.text) >= len(same), cell
    assert 'not available' not in said


def test_a_verdict_stands_beside_every_number_that_can_be_compared(tables):
    compared = {key: len(compared_cells(table)) for key, table in tables.items()}
    assert compared['table_5_3'] == 40 + 20
    assert compared['table_5_5'] == 12 + 12
    assert compared['table_5_4'] == 6
    assert compared['table_5_7'] == 2 * 7
    assert compared['figure_4_30'] == 2 * (3 + 6)
    assert compared['figures_5_1_to_5_3'] == 4
    assert compared['table_5_2'] == 24 - 1 - 3


def test_the_summary_counts_what_the_tables_say(written, tables, said):
    _, folder = written
    records = json.loads((folder / 'report.json').read_text())['comparisons']
    counts = re.findall(
        r'(The same method|As shipped): of (\d+) cells beside the thesis '
        r'(\d+) better, (\d+) equal, (\d+) worse',
        said,
    )
    assert len(counts) == 2
    for name, *numbers in counts:
        chosen = [r for r in records if r['by'] == name.lower()]
        verdicts = [verdict(r) for r in chosen]
        assert verdicts == [r['verdict'] for r in chosen]
        expected = [len(chosen), *(verdicts.count(v) for v in ('better', 'equal', 'worse'))]
        assert [int(number) for number in numbers] == expected
    page = (folder / 'index.html').read_text()
    worse = sum(r['verdict'] == 'worse' for r in records)
    assert sum(len(tables[key].rows) for key in ('worse_method', 'worse_shipped')) == worse
    marked = re.findall(r'<span class="verdict \w+">(better|equal|worse)</span>', page)
    assert sorted(marked) == sorted(r['verdict'] for r in records)


def verdict(record):
    """The rule written out again."""
    ours, theirs = record['ours'], record['thesis']
    if record['table'] == 'Table 5.4':
        near = 0.06 if 'frequency' in record['column'] else 0.05 * theirs
        return 'equal' if abs(ours - theirs) <= near else 'worse'
    if record['table'] == 'Table 5.2' and 'Marker Definition' in record['row'] and theirs == 0.01:
        return 'equal' if ours < theirs else 'worse'
    inside = record['low'] is not None and record['low'] <= theirs <= record['high']
    if inside or abs(ours - theirs) <= 0.01 * abs(theirs):
        return 'equal'
    return 'better' if ours < theirs else 'worse'


def test_what_is_said_of_table_5_3(tables, said):
    rows = {row[:3]: values(tables['table_5_3'], *row[:3])[0] for row in tables['table_5_3'].rows}
    wins = re.search(r'Here velocity only is smaller than full estimation for ([^.]*)\.', said)
    assert wins is not None
    counted = re.findall(r'(\d) of 5 in trial (\d)', wins.group(1))
    assert [trial for _, trial in counted] == list('1234')
    above = {kind: 0 for kind in known.ESTIMATIONS}
    for count, number in counted:
        title = next(t for t, _, _ in rows if t.startswith(f'Trial {number}'))
        velocity, full = (rows[title, kind, 'here'] for kind in known.ESTIMATIONS)
        assert int(count) == sum(v < f for v, f in zip(velocity, full, strict=True))
        for kind, cells in zip(known.ESTIMATIONS, (velocity, full), strict=True):
            above[kind] += sum(cell >= 1.0 for cell in cells)
    for kind, count in above.items():
        found = re.search(rf'above 1 px: {kind.lower()} .*? (\d+) of 20 above; the worst', said)
        assert found is not None and int(found.group(1)) == count
    ratios = tables['table_5_3_ratio'].rows
    printed, ours = ([row[2:] for row in ratios if row[1] == by] for by in ('thesis', 'here'))
    larger = int(np.sum(np.array(ours) > np.array(printed)))
    assert f'of 20 cells, larger in {larger}.' in said
    faster = re.search(r'Here it is more than that for ([^:]*):', said)
    assert faster is not None
    for number, told in enumerate(re.findall(r'(\d) of 5 in trial', faster.group(1)), 1):
        moved = next(
            row[2:]
            for row in ratios
            if row[0].startswith(f'Trial {number}') and row[1].startswith('acceleration')
        )
        printed_cells = [
            known.cell('table_5_3', f'Trial {number}, Velocity Only', name).value
            for name in known.MARKERS
        ]
        assert int(told) == sum(a > v for a, v in zip(moved, printed_cells, strict=True))
    # Of the thesis's own numbers.
    assert 'velocity only is smaller in 14 of 20 cells, full estimation in 5, 1 equal' in said


def test_what_is_said_of_vibration(tables, said):
    table = tables['table_5_3_vibration']
    shaken = [row for row in table.rows if row[1] != 'No Motion']
    names = [column.name for column in table.columns[2:-1]]
    best = [names[int(np.argmin(row[2:-1]))] for row in shaken]
    assert best == [row[-1] for row in shaken]
    found = re.search(r'Best of the (\d+) shaken flights: ([^.]*)\.', said)
    assert found is not None and int(found.group(1)) == len(shaken)
    told = dict(part.rsplit(' on ', 1) for part in found.group(2).split(', '))
    assert {name: int(number) for name, number in told.items()} == {
        name: best.count(name) for name in set(best)
    }
    smooths = sum(
        all(row[2 + names.index('acceleration program')] < row[2 + names.index(e)] for e in ahead)
        for row in shaken
        for ahead in [('velocity', 'acceleration')]
    )
    assert f'beats both extrapolators (velocity and the equations) on {smooths} of' in said


def test_what_is_said_of_the_roll(tables, said):
    table = tables['table_5_5']
    for by, words in (
        ('thesis', 'The RMS in the thesis'),
        ("the thesis's program", "Here, by the thesis's program"),
    ):
        rows = [[float(cell) for cell in values(table, c, by)[0]] for c in known.CONDITIONS]
        growing = sum((np.diff(column) > 0).all() for column in np.array(rows).T)
        assert f'{words}: grows with the vibration in {growing} of 3 columns' in said
    *ours, thesis = tables['table_5_5_noise'].rows
    for noise, by, *cells in ours:
        below = sum(c < float(p) for c, p in zip(cells, thesis[2:], strict=True))
        assert f'{by} at {noise} in {below}' in said
    for by in ("the thesis's program", 'as shipped'):
        calm, shaken = (
            [float(text.split()[0]) for text in values(tables['table_5_5_truth'], c, by)[0]]
            for c in known.CONDITIONS[:2]
        )
        found = re.search(rf'error of {by} changes by factors of ([\d.]+) to ([\d.]+)\.', said)
        assert found is not None
        # The table shows four digits after the point, the text two.
        pairs = list(zip(calm, shaken, strict=True))
        low = [(b - 0.5e-4) / (a + 0.5e-4) for a, b in pairs]
        high = [(b + 0.5e-4) / (a - 0.5e-4) for a, b in pairs]
        assert min(low) - 0.005 <= float(found.group(1)) <= min(high) + 0.005
        assert max(low) - 0.005 <= float(found.group(2)) <= max(high) + 0.005


def test_what_is_said_of_the_runway(tables, said):
    outside = []
    for scene, count, right, at_least, wrong, at_most in tables['approach'].rows:
        if not count or right < at_least or wrong > at_most:
            outside.append(scene)
        if count:
            assert f'Mode approach finds both edges: {scene} ' in said
            assert f'{right:.1f} % right, {wrong:.1f} % confident and wrong' in said
    expected = f'Outside of the limits: {", ".join(outside)}.' if outside else 'All within'
    assert expected in said
    rows = tables['runway_flags'].rows
    by_scene = {}
    for scene, by, *_, combined, lines in rows:
        flags = int(combined.split(' / ')[0])
        by_scene.setdefault(scene, {})[by] = flags
        counts = [int(number) for number in lines.split(', ')]
        assert max(counts) <= flags <= sum(counts)
    fewer = sum(flags['as shipped'] < flags['config/thesis.yaml'] for flags in by_scene.values())
    assert f'raise a flag in fewer frames on {fewer} of {len(by_scene)} scenes' in said


def test_the_thesiss_contradictions_are_said(said):
    stages = [known.cell('table_5_7', stage, 'time').value for stage in known.RUNWAY_STAGES]
    assert sum(stages[:-1]) == pytest.approx(8.578, abs=0.001)
    assert 'The stages of Table 5.7 in the thesis add up to 8.578 s, not to the 7.9062 s' in said
    for program, adds_up in zip(known.PROGRAMS, (True, False, False), strict=True):
        times = [known.cell('table_5_2', stage, f'{program}, time') for stage in known.STAGES]
        numbers = [cell.value for cell in times if cell.text != 'N/A']
        assert (abs(sum(numbers[:-1]) - numbers[-1]) < 0.001 * numbers[-1]) is adds_up
    assert "The thesis's caption says trial 3, its text trial 2" in said


def test_times_add_up(tables):
    table = tables['table_5_2']
    for program in range(3):
        column = 2 + 4 * program
        times = [getattr(row[column], 'value', row[column]) for row in table.rows]
        stages = [value for value in times[:-1] if isinstance(value, float)]
        assert sum(stages) == pytest.approx(times[-1])
        assert math.isfinite(times[-1])
    for column in (2, 3):
        cells = [row[column] for row in tables['table_5_7'].rows]
        times = [getattr(cell, 'value', cell) for cell in cells]
        assert sum(times[:-1]) == pytest.approx(times[-1])
    shares = [row[7] for row in tables['table_5_7'].rows]
    assert sum(shares[:-1]) == pytest.approx(100.0) == shares[-1]
    here = [getattr(row[2], 'value', row[2]) for row in tables['table_5_7'].rows]
    assert shares == pytest.approx([100.0 * seconds / sum(here[:-1]) for seconds in here])
    printed = [float(row[1]) for row in tables['table_5_7'].rows]
    assert [row[6] for row in tables['table_5_7'].rows] == pytest.approx(
        [100.0 * seconds / printed[-1] for seconds in printed]
    )

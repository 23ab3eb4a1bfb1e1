import csv
import json
import math
import re

import cv2
import numpy as np
import pytest

from mvuav_ros.offline.report.model import (
    NOT_AVAILABLE,
    Claim,
    Column,
    Figure,
    Report,
    Section,
    Table,
)
from mvuav_ros.offline.report.page import render_page
from mvuav_ros.offline.report.style import drawing, label, legend_below
from mvuav_ros.offline.report.writing import write_report
from mvuav_ros.offline.thesis.build import build_report, steps_of
from mvuav_ros.offline.thesis.plan import Plan

SMALL = Plan(
    seed=5,
    jobs=1,
    trial_frames=12,
    passes=1,
    timed_frames=8,
    spectrum_seconds=2.0,
    repeats=1,
    runway_frames=6,
    identity_scenes=1,
    identity_repeats=1,
    pose_frames=60,
)
TABLES = {
    'table_5_2',
    'table_5_3',
    'table_5_3_vibration',
    'table_5_3_truth_found',
    'table_5_3_truth_predicted',
    'table_5_4',
    'table_5_5',
    'table_5_5_truth',
    'table_5_7',
    'times_by_method',
    'runway_truth',
    'names',
    'pose',
}
FIGURES = {f'figure_5_{number}' for number in range(1, 16)} | {'figure_roll_vibration'}


@pytest.fixture(scope='module')
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp('thesis')
    steps = []
    report = build_report(SMALL, lambda: steps.append(1), 'evaluate thesis --seed 5')
    assert len(steps) == steps_of(SMALL)
    write_report(report, folder)
    return report, folder


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


def test_the_page_says_what_made_it_and_what_is_not_known(written):
    report, folder = written
    settings = json.loads((folder / 'report.json').read_text())['settings']
    assert settings['seed'] == 5
    assert settings['command'] == 'evaluate thesis --seed 5'
    assert 'prediction=velocity' in settings['marker_tracker as in the thesis']
    assert 'threshold=0.7' in settings['marker_tracker as shipped']
    page = render_page(report)
    assert settings['version'] in page
    assert NOT_AVAILABLE in page
    known = [claim for claim in report.claims if claim.thesis == NOT_AVAILABLE]
    assert [claim.holds for claim in known] == [None]


def test_shares_of_the_stages_add_up(written):
    for table in written[0].tables():
        if table.key not in ('table_5_2', 'table_5_7'):
            continue
        for part in {row[0] for row in table.rows}:
            shares = [row[3] for row in table.rows if row[0] == part and row[1] != 'together']
            assert sum(shares) == pytest.approx(100.0)


def small_report(**changes):
    table = Table('t', 'T', (Column('a'), Column('b', 'px', 1)), (('<x>', 1.25), ('y', math.nan)))
    given = {'title': 'A & B', 'lead': ('<lead>',), 'settings': {'seed': 1}}
    return Report(**{**given, 'sections': (Section('S', ('1 < 2',), (table,)),), **changes})


def test_text_is_escaped_and_missing_numbers_are_dashes(tmp_path):
    report = small_report(claims=(Claim('<claim>', 'a', 'b', False),))
    page = render_page(report)
    for raw, escaped in (('<x>', '&lt;x&gt;'), ('<lead>', '&lt;lead&gt;'), ('A & B', 'A &amp; B')):
        assert escaped in page
        assert raw not in page
    assert '<td>–</td>' in page  # noqa: RUF001
    assert '>1.2<' in page
    assert '✗ no' in page
    write_report(report, tmp_path)
    assert (tmp_path / 't.csv').read_text().splitlines() == ['a,b [px]', '<x>,1.25', 'y,']
    assert json.loads((tmp_path / 't.json').read_text())[1] == {'a': 'y', 'b [px]': None}


def test_a_table_with_a_ragged_row_is_refused():
    with pytest.raises(ValueError, match='3 cells for 2 columns'):
        Table('t', 'T', (Column('a'), Column('b')), ((1, 2, 3),))


def test_the_same_data_make_the_same_image():
    def draw(last):
        with drawing(4.0, 2.0) as canvas:
            axes = canvas.figure.subplots()
            axes.plot([1, last], label='curve')
            label(axes, 'title', 'time [s]', 'x [px]')
            legend_below(canvas.figure, axes)
        return Figure('p', 'P', canvas.png)

    assert draw(2).png == draw(2).png != draw(3).png

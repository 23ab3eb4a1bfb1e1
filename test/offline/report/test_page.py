import json
import math

import pytest

from mvuav_ros.offline.report.comparison import SHIPPED, Compared, Verdict, worst_first
from mvuav_ros.offline.report.model import (
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
    assert '✗ does not hold' in page
    write_report(report, tmp_path)
    assert (tmp_path / 't.csv').read_text().splitlines() == ['a,b [px]', '<x>,1.25', 'y,']
    assert json.loads((tmp_path / 't.json').read_text())[1] == {'a': 'y', 'b [px]': None}


def test_a_table_with_a_ragged_row_is_refused():
    with pytest.raises(ValueError, match='3 cells for 2 columns'):
        Table('t', 'T', (Column('a'), Column('b')), ((1, 2, 3),))


def test_columns_are_read_from_a_heading():
    heading = 'line | distance, RMS [px] .2 | rate [frames/s] | share .0'
    table = Table.of('t', 'T', heading, [('left', 1.25, 30.0, None)], 'A note.')
    distance, rate = Column('distance, RMS', 'px', 2), Column('rate', 'frames/s')
    assert table.columns == (Column('line'), distance, rate, Column('share', '', 0))
    assert (table.rows, table.notes) == ((('left', 1.25, 30.0, None),), ('A note.',))


def test_the_same_data_make_the_same_image():
    def draw(last):
        with drawing(4.0, 2.0) as canvas:
            axes = canvas.figure.subplots()
            axes.plot([1, last], label='curve')
            label(axes, 'title', 'time [s]', 'x [px]')
            legend_below(canvas.figure, axes)
        return Figure('p', 'P', canvas.png)

    assert draw(2).png == draw(2).png != draw(3).png


@pytest.mark.parametrize(
    ('cell', 'verdict'),
    [
        (Compared(0.5, 1.0), Verdict.BETTER),
        (Compared(0.995, 1.0), Verdict.EQUAL),
        (Compared(1.02, 1.0), Verdict.WORSE),
        (Compared(1.2, 1.0, low=0.9, high=1.5), Verdict.EQUAL),
        (Compared(1.2, 1.0, low=1.1, high=1.3), Verdict.WORSE),
        (Compared(0.005, 0.01, is_bound=True), Verdict.EQUAL),
        (Compared(0.02, 0.01, is_bound=True), Verdict.WORSE),
        (Compared(11.05, 11.06, tolerance=0.06), Verdict.EQUAL),
        (Compared(10.9, 11.06, tolerance=0.06), Verdict.WORSE),
    ],
)
def test_verdicts(cell, verdict):
    assert cell.verdict is verdict


def test_the_summary_counts_the_cells_and_begins_with_the_worst():
    cells = (0.5, 1.0, 1.5, 3.0)
    rows = (
        *(('r', f'row {v:g}', Compared(v, 1.0)) for v in cells),
        ('r', 's', Compared(2.0, 1.0, SHIPPED)),
    )
    columns = (Column('a'), Column('b'), Column('c'))
    report = small_report(
        sections=(Section('S', (), (Table('t', 'Table 9: T', columns, rows),)),),
        claims=(Claim('good', '', '', True), Claim('bad', '', '', False), Claim('?', '', '', None)),
    )
    page = render_page(report)
    assert 'of 4 cells beside the thesis 1 better, 1 equal, 2 worse' in page
    assert 'of 1 cells beside the thesis 0 better, 0 equal, 1 worse' in page
    worst = worst_first([c for c in report.comparisons() if c.compared.by != SHIPPED])
    assert [c.compared.value for c in worst] == [3.0, 1.5]
    assert page.index('Table 9, r, row 3, c: 3 against 1') < page.index(
        'Table 9, r, row 1.5, c: 1.5'
    )
    assert page.index('>bad<') < page.index('>?<') < page.index('>good<')
    assert report.tables()[0].records()[0]['c'] == 0.5

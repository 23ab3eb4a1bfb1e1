import json
import math

import pytest

from mvuav_ros.offline.report import (
    Column,
    Figure,
    JudgedCell,
    Report,
    Section,
    Table,
    render_page,
    write_report,
)
from mvuav_ros.offline.report_figures import drawing, label, legend_below


def small_report(**changes):
    table = Table('t', 'T', (Column('a'), Column('b', 'px', 1)), (('<x>', 1.25), ('y', math.nan)))
    given = {'title': 'A & B', 'lead': ('<lead>',), 'settings': {'seed': 1}}
    return Report(**{**given, 'sections': (Section('S', ('1 < 2',), (table,)),), **changes})


def test_text_is_escaped_and_missing_numbers_are_dashes(tmp_path):
    report = small_report()
    page = render_page(report)
    for raw, escaped in (('<x>', '&lt;x&gt;'), ('<lead>', '&lt;lead&gt;'), ('A & B', 'A &amp; B')):
        assert escaped in page
        assert raw not in page
    assert '<td>–</td>' in page  # noqa: RUF001
    assert '>1.2<' in page
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


def test_numbers_at_an_axis_are_whole_ones():
    """Not 0.0042 with +18.85 in a corner, as of rolls that hardly differ."""
    with drawing() as canvas:
        axes = canvas.figure.subplots()
        axes.plot([18.85421, 18.85423])
        canvas.figure.draw_without_rendering()
        assert not axes.yaxis.get_offset_text().get_text()


class Judged(JudgedCell):
    value = 2.5
    mark = 'bad'

    def parts(self, digits):
        return f'{self.value:.{digits}f}', '[2, 3]', 'too <much>'


def test_a_cell_with_a_verdict(tmp_path):
    table = Table('t', 'T', (Column('a'), Column('b', '', 2)), (('x', Judged()),))
    report = small_report(sections=(Section('S', (), (table,)),), data={'more': [1]})
    page = render_page(report)
    assert '<td>2.50<span class="range">[2, 3]</span>' in page
    assert '<span class="verdict bad">too &lt;much&gt;</span></td>' in page
    assert table.text(0, 1) == '2.50 [2, 3] too <much>'
    write_report(report, tmp_path)
    data = json.loads((tmp_path / 'report.json').read_text())
    assert data['tables']['t'] == [{'a': 'x', 'b': 2.5}]
    assert data['more'] == [1]

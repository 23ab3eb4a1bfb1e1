import pytest

from mvuav_ros.offline.report import Column, Table
from mvuav_thesis.comparison import SHIPPED, Claim, Compared, Verdict, compared_cells, summary


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
    rows = (
        *(('r', f'row {v:g}', Compared(v, 1.0)) for v in (0.5, 1.0, 1.5, 3.0)),
        ('r', 's', Compared(2.0, 1.0, SHIPPED)),
    )
    table = Table('t', 'Table 9: T', (Column('a'), Column('b'), Column('c')), rows)
    claims = [Claim('good', '', '', True), Claim('bad', '', '', False), Claim('?', '', '', None)]
    section = summary(compared_cells(table), claims)
    assert section.paragraphs == (
        'The same method: of 4 cells beside the thesis 1 better, 1 equal, 2 worse.',
        'As shipped: of 1 cells beside the thesis 0 better, 0 equal, 1 worse.',
    )
    method, shipped, claimed = section.items
    assert [row[:5] for row in method.rows] == [
        ('Table 9', 'r, row 3', 'c', 3.0, 1.0),
        ('Table 9', 'r, row 1.5', 'c', 1.5, 1.0),
    ]
    assert [row[3] for row in shipped.rows] == [2.0]
    assert [row[0] for row in claimed.rows] == ['bad', '?', 'good']
    assert [row[3].mark for row in claimed.rows] == ['bad', 'neutral', 'good']
    assert table.records()[0]['c'] == 0.5

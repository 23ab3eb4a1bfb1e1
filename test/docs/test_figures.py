"""Every measured figure on a page is that of docs/figures, and every other number is stated."""

import importlib.util
import json
import re

import pytest
from support.places import ROOT

spec = importlib.util.spec_from_file_location('figures', ROOT / 'tools' / 'figures.py')
figures = importlib.util.module_from_spec(spec)
spec.loader.exec_module(figures)


@pytest.fixture
def copy(tmp_path, monkeypatch):
    """A repository with one evaluation and one page."""
    (tmp_path / 'docs' / 'figures').mkdir(parents=True)
    monkeypatch.setattr(figures, 'ROOT', tmp_path)
    monkeypatch.setattr(figures, 'DATA', tmp_path / 'docs' / 'figures')
    monkeypatch.setattr(figures, 'STATED', tmp_path / 'docs' / 'figures' / 'stated.txt')
    content = {
        'figures': {'wrong': figures.figure(9, 'frames')},
        'tables': {'all': figures.table(['flight', 'wrong'], [['calm', '0.5 %']])},
    }
    (tmp_path / 'docs/figures/markers.json').write_text(json.dumps(content))
    (tmp_path / 'README.md').write_text(
        'A window of 12 px.\n<!-- figure: markers.wrong -->9 frames<!-- /figure -->\n'
        '<!-- table: markers.all -->\n| flight | wrong |\n|---|---|\n| calm | 0.5 % |\n'
        '<!-- /table -->\n'
    )
    figures.write_stated({'README.md': figures.unmeasured((tmp_path / 'README.md').read_text())})
    return tmp_path


def test_the_pages_hold_the_figures_of_the_data():
    assert figures.problems() == []


def test_each_evaluation_says_where_it_comes_from():
    for name, evaluation in figures.load().items():
        assert evaluation['command'] and evaluation['date'], name
        assert re.match('[0-9a-f]{7}', evaluation['version']), f'{name} names no commit'


def test_a_page_in_order_has_no_problems(copy):
    assert figures.problems() == []


@pytest.mark.parametrize(
    ('old', 'new', 'problem'),
    [
        ('9 frames', '10 frames', 'figures differ'),
        ('0.5 %', '0.4 %', 'figures differ'),
        ('markers.wrong', 'markers.right', 'no figure'),
        ('12 px', '13 px', '13 px is neither measured nor stated'),
        ('12 px', '12 px', ''),
        ('A window of 12 px.', '', '12 px is stated, but not there'),
        ('A window', 'It misses 7 % of them. A window', '7 % is neither'),
    ],
)
def test_a_changed_number_is_found(copy, old, new, problem):
    page = copy / 'README.md'
    page.write_text(page.read_text().replace(old, new))
    found = figures.problems()
    assert any(problem in line for line in found) if problem else not found


def test_a_new_measurement_reaches_the_page(copy):
    path = copy / 'docs/figures/markers.json'
    path.write_text(path.read_text().replace('9 frames', '8 frames').replace('0.5 %', '0.6 %'))
    page = copy / 'README.md'
    page.write_text(figures.renewed(page.read_text(), figures.load()))
    assert '-->8 frames<!--' in page.read_text() and '| calm | 0.6 % |' in page.read_text()


def test_the_flights_of_compare_markers_become_figures(copy):
    figures.markers(ROOT / 'test/data/marker_flights.json')
    content = figures.load()['markers']
    rows = content['tables']['kept_back']['rows']
    flights = sum(int(row[1].split(';')[0]) for row in rows)
    wrong = sum(int(row[2].split(';')[0]) for row in rows)
    assert content['figures']['all.flights']['value'] == flights > 300
    assert content['figures']['all.wrong']['value'] == wrong


def test_numbers_in_code_and_links_are_not_counted():
    text = 'The `12 px` of [it](a.md#3-px).\n\n```bash\nsleep 3 s\n```\n\n2.5 ms and 1,000 frames\n'
    assert [shown for _, shown, _ in figures.numbers(text)] == ['2.5 ms', '1,000 frames']


def test_the_stills_are_those_that_were_measured_with_the_flights():
    measured = json.loads((ROOT / 'docs/figures/approach.json').read_text())['tables']['stills']
    right = {row[0]: float(row[3].removesuffix(' %')) for row in measured['rows']}
    stated = json.loads((ROOT / 'docs/figures/stills.json').read_text())['figures']
    assert stated['near']['value'] == round(right['stills check near'])
    assert stated['far']['value'] == round(right['stills check far'])

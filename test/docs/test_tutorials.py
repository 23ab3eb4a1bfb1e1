"""The quick start and the tutorials run as printed, and print what they show.

Shell blocks run in ``bash``; Python blocks are pasted into one ``python -i`` for the page. A
``text`` block is what the block before it prints: ``support.printed_output`` has the tolerance.
"""

import re
from collections import Counter

import pytest
from support.graph import claim_domain
from support.places import ROOT
from support.printed_output import difference
from support.tutorial_blocks import TutorialRun, blocks_of

PAGES = {
    path.stem: path
    for path in [
        ROOT / 'docs/quick-start.md',
        ROOT / 'docs/hardware.md',
        *sorted((ROOT / 'docs/tutorials').glob('*.md')),
    ]
    if path.stem != 'index'
}
EXECUTED = ('bash', 'python')


def follow(page, reader, name):
    """Run the blocks of a page and compare what they print."""
    printed = ''
    for block in blocks_of(page):
        if block.kind == 'text':
            found = difference(block.text, printed)
            assert not found, f'{name}, line {block.line}: {found}\n\nPrinted was:\n{printed}'
        elif block.kind in EXECUTED and not block.reason:
            printed = reader.run(block)


@pytest.mark.parametrize('name', PAGES)
def test_every_block_runs_and_prints_what_is_shown(name, tmp_path):
    number, claim = claim_domain()
    # The quick start is for a fresh clone; the tutorials begin with `mkdir -p out/tutorial`.
    with claim, TutorialRun(tmp_path, number, prepared=name != 'quick-start') as reader:
        follow(PAGES[name].read_text(), reader, name)


@pytest.mark.parametrize('name', PAGES)
def test_most_blocks_are_run_and_the_others_say_why(name):
    blocks = [block for block in blocks_of(PAGES[name].read_text()) if block.kind != 'text']
    assert {block.kind for block in blocks} <= {*EXECUTED, 'yaml'}
    shown = [block for block in blocks if block.kind in EXECUTED and block.reason]
    run = [block for block in blocks if block.kind in EXECUTED and not block.reason]
    assert len(run) >= 3
    assert len(shown) <= 2
    assert all(len(block.reason) > 10 for block in shown)


def test_no_two_pages_make_one_file():
    """A reader of all of them would have to overwrite it."""
    made = Counter(
        place
        for page in PAGES.values()
        for place in {*re.findall(r'(?:-o|>) (out/\S+)', page.read_text())}
    )
    assert len(made) > 20
    assert [place for place, pages in made.items() if pages > 1] == []


@pytest.fixture
def reader(tmp_path):
    with TutorialRun(tmp_path, 99) as run:
        yield run


def test_names_are_kept_from_block_to_block(reader):
    first, second = blocks_of('```python\na = 3\n```\n```python\nprint(a + 1)\n```\n')
    reader.run(first)
    assert reader.run(second) == '4\n'


def test_a_reason_is_the_line_above_a_block_that_is_not_run():
    (block,) = blocks_of('*Not run by the tests: needs a robot.*\n\n```bash\nx\n```\n')
    assert block.reason == 'needs a robot.'


@pytest.mark.parametrize(
    'block',
    [
        '```bash\ntrue; false\necho on\n```\n',
        '```python\nunknown\n```\n',
        # Python 3.11 takes these from a file, but not pasted into a session.
        '```python\nfor i in (1, 2):\n    print(i)\nprint(3)\n```\n',
        '```python\nfor i in (1, 2):\n    print(i)\n\n    print(3)\n```\n',
    ],
)
def test_a_page_that_does_not_run_fails(block, reader):
    with pytest.raises(AssertionError, match='line 1'):
        follow(block, reader, 'page')


def test_a_page_that_shows_another_output_fails(reader):
    page = '```bash\necho 62 % of the lines\n```\n\n```text\n{} % of the lines\n```\n'
    follow(page.format(62), reader, 'page')
    with pytest.raises(AssertionError, match='page, line 5'):
        follow(page.format(60), reader, 'page')

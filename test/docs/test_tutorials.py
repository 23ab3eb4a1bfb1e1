"""Every command and every code block of the quick start and of the tutorials runs as printed."""

import pytest
from support.graph import _claim_domain
from support.places import ROOT
from support.tutorial_blocks import TutorialRun, blocks_of, missing_lines

PAGES = {
    path.stem: path
    for path in [ROOT / 'docs/quick-start.md', *sorted((ROOT / 'docs/tutorials').glob('*.md'))]
    if path.stem != 'index'
}
EXECUTED = ('bash', 'python')


@pytest.mark.long
@pytest.mark.parametrize('name', PAGES)
def test_every_block_runs(name, tmp_path):
    number, claim = _claim_domain()
    reader = TutorialRun(tmp_path, number)
    printed = ''
    with claim:
        for block in blocks_of(PAGES[name].read_text()):
            if block.kind == 'text':
                missing = list(missing_lines(block.text, printed))
                assert not missing, f'{name}, line {block.line}: {missing} not in:\n{printed}'
            elif block.kind in EXECUTED and not block.reason:
                printed = reader.run(block)


@pytest.mark.parametrize('name', PAGES)
def test_most_blocks_are_run_and_the_others_say_why(name):
    blocks = [block for block in blocks_of(PAGES[name].read_text()) if block.kind != 'text']
    assert {block.kind for block in blocks} <= {*EXECUTED, 'yaml'}
    shown = [block for block in blocks if block.kind in EXECUTED and block.reason]
    run = [block for block in blocks if block.kind in EXECUTED and not block.reason]
    assert len(run) >= 3
    assert len(shown) <= 2
    assert all(len(block.reason) > 10 for block in shown)


def test_a_page_that_does_not_run_fails(tmp_path):
    reader = TutorialRun(tmp_path, 99)
    first, second, third, fourth = blocks_of(
        '```bash\ntrue; false\necho on\n```\n\n```python\na = 3\n```\n'
        '```python\nprint(a + 1)\n```\n*Not run by the tests: needs a robot.*\n\n```bash\nx\n```\n'
    )
    with pytest.raises(AssertionError, match='line 1'):
        reader.run(first)
    reader.run(second)
    assert reader.run(third) == '4\n'
    assert fourth.reason == 'needs a robot.'


def test_an_output_that_is_not_printed_is_found():
    shown = 'roll 3.1 deg\n…\n5 of 5 markers'
    assert list(missing_lines(shown, 'roll -12.7e-3 deg\n4 of 5 markers\n')) == []
    assert list(missing_lines(shown, 'roll nan deg\n4 of 5 lights\n')) == ['5 of 5 markers']

"""The lines that check_mutations breaks."""

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[2] / 'tools'))

from check_mutations import MUTATIONS, ROOT


@pytest.mark.parametrize('mutation', MUTATIONS, ids=lambda mutation: mutation.name)
def test_a_line_to_break_is_in_its_file_once_and_has_tests(mutation):
    assert (ROOT / mutation.file).read_text().count(mutation.right) == 1
    assert all((ROOT / test).exists() for test in mutation.tests)

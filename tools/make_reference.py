"""Writes config/default.yaml and the reference pages from the code: make docs.

With ``--check`` nothing is written: the exit status is 1 where a file is out of date.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path

from reference_pages.command_line import command_line_page
from reference_pages.diagnostics import diagnostics_page
from reference_pages.file_formats import file_formats_page
from reference_pages.parameters import default_yaml, parameter_tables
from reference_pages.python_api import python_page
from reference_pages.topics import topics_page

ROOT = Path(__file__).resolve().parent.parent
FILES: Mapping[str, Callable[[], str]] = {
    'config/default.yaml': default_yaml,
    'docs/reference/parameters.md': parameter_tables,
    'docs/reference/topics.md': topics_page,
    'docs/reference/command-line.md': command_line_page,
    'docs/reference/diagnostics.md': diagnostics_page,
    'docs/reference/file-formats.md': file_formats_page,
    'docs/reference/python.md': python_page,
}


def main() -> int:
    """Write every file, or only compare."""
    check = sys.argv[1:] == ['--check']
    status = 0
    for name, make in FILES.items():
        path, text = ROOT / name, make()
        if path.exists() and path.read_text(encoding='utf-8') == text:
            continue
        print(f'{name} is out of date: make docs' if check else name)
        if check:
            status = 1
        else:
            path.write_text(text, encoding='utf-8')
    return status


if __name__ == '__main__':
    sys.exit(main())

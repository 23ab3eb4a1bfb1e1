"""Where things lie: the project's root, and the footage beside it."""

import importlib.util
import os
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
SHARED = Path(os.environ.get('MVUAV_SHARED', ROOT.parent / 'shared'))
FOOTAGE = Path(os.environ.get('MVUAV_FOOTAGE') or SHARED / 'footage')


def load_tool(name: str) -> Any:
    """A program of ``tools`` as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / 'tools' / f'{name}.py')
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module

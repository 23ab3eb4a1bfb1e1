"""Where things lie: the project's root, and the footage beside it."""

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SHARED = Path(os.environ.get('MVUAV_SHARED', ROOT.parent / 'shared'))
FOOTAGE = Path(os.environ.get('MVUAV_FOOTAGE') or SHARED / 'footage')

"""Where the shipped parameter files and sample bags lie: in a checkout, or installed."""

from __future__ import annotations

import sys
from pathlib import Path


def shipped_folder(name: str) -> Path | None:
    """The folder ``config`` or ``bags``; None where it is not installed."""
    package = Path(__file__).resolve().parent.parent
    # colcon: install/mvuav_ros/lib/python3.x/site-packages/mvuav_ros
    shares = [Path(sys.prefix), *package.parents]
    places = [package.parent / name, *(base / 'share' / 'mvuav_ros' / name for base in shares)]
    return next((place for place in places if place.is_dir()), None)

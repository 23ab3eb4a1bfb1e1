"""Where the shipped parameter files and sample bags lie: in a checkout, or installed."""

from __future__ import annotations

import sys
from pathlib import Path


def _folder(name: str) -> Path | None:
    package = Path(__file__).resolve().parent.parent
    # colcon: install/mvuav_ros/lib/python3.x/site-packages/mvuav_ros
    shares = [Path(sys.prefix), *package.parents]
    places = [package.parent / name, *(base / 'share' / 'mvuav_ros' / name for base in shares)]
    return next((place for place in places if place.is_dir()), None)


def built_in_sets() -> Path | None:
    """The folder with ``default.yaml`` and ``thesis.yaml``."""
    return _folder('config')


def sample_bags() -> list[Path]:
    """The folder of the sample bags, where they are installed."""
    folder = _folder('bags')
    return [folder] if folder is not None else []

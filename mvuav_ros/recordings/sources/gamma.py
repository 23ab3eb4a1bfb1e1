"""Gamma correction of what a source yields (eq. 3.2), as ``video_source`` does it live."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace
from typing import TypeVar

from mvuav_ros.recordings.sources.frame import Frame

ItemT = TypeVar('ItemT')


def gamma_corrected(
    items: Generator[ItemT, None, None], gamma: float
) -> Generator[ItemT | Frame, None, None]:
    """The items with the image of every frame corrected; whatever is no frame goes through.

    Args:
        items: closed when this is.
        gamma: greater than 0; above 1 darkens, 1 changes nothing.
    """
    try:
        for item in items:
            if isinstance(item, Frame) and gamma != 1.0:
                yield replace(item, image=item.image.gamma_corrected(gamma))
            else:
                yield item
    finally:
        items.close()

"""Gamma correction of what a source yields (eq. 3.2), as ``video_source`` does it live."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace
from typing import TypeVar

from mvuav_ros.recordings.sources.encoded_frame import EncodedFrame
from mvuav_ros.recordings.sources.frame import BadFrame, Frame

ItemT = TypeVar('ItemT')


def gamma_corrected(
    items: Generator[ItemT, None, None], gamma: float
) -> Generator[ItemT | Frame | BadFrame, None, None]:
    """The items with the image of every frame corrected; whatever is no frame goes through.

    A gamma above 1 darkens, 1 changes nothing. The items are closed when this is.
    """
    try:
        for item in items:
            frame = item.decoded() if isinstance(item, EncodedFrame) and gamma != 1.0 else item
            if isinstance(frame, Frame) and gamma != 1.0:
                yield replace(frame, image=frame.image.gamma_corrected(gamma))
            else:
                yield frame
    finally:
        items.close()

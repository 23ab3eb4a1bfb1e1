"""The names of the markers whose results a bag holds."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.processing.processor import Processor, resolve
from mvuav_ros.recordings.images import decode_message
from mvuav_ros.recordings.serialization.messages import stamp_ns_of

PREFIX = '/marker_tracker/marker/'
"""Of the topics that hold one marker each; its name follows."""
_TYPE = 'geometry_msgs/msg/PointStamped'
_SAME_PLACE = 1e-2
"""px; rows are in single precision, points in double."""


class NamedPoints:
    """What the topics of single markers say, to find the row that each of them repeats.

    The order of topics tells nothing: `ros2 bag record` lists them as they were discovered.
    """

    def __init__(self) -> None:
        """Begin with nothing."""
        self._points: dict[str, dict[int, tuple[float, float]]] = defaultdict(dict)

    def add(self, topic: str, data: bytes | memoryview) -> None:
        """Take in a message's CDR.

        Raises:
            MalformedMessageError: it is no PointStamped.
        """
        message = decode_message(_TYPE, data)
        place = float(message.point.x), float(message.point.y)
        self._points[topic.removeprefix(PREFIX)][stamp_ns_of(message.header)] = place

    def names(self, markers: Mapping[int, NDArray[np.void]]) -> dict[int, str]:
        """The names that are certain, by label.

        Args:
            markers: rows of ``~/markers`` by stamp, ns.
        """
        found: dict[int, str] = {}
        for name, points in self._points.items():
            for stamp in points.keys() & markers.keys():
                rows, (x, y) = markers[stamp], points[stamp]
                near = rows[np.hypot(rows['x'] - x, rows['y'] - y) < _SAME_PLACE]
                if len(near) == 1:
                    found[int(near['label'][0])] = name
                    break
        return found


def names_of(processors: Iterable[Processor]) -> dict[int, str]:
    """The names of the rig that is tracked, by label."""
    topics = (resolve(t, f'/{each.name}') for each in processors for t in each.topics)
    return dict(enumerate(t.removeprefix(PREFIX) for t in topics if t.startswith(PREFIX)))

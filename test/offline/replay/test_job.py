"""What replay makes of a node's outputs and of its mistakes."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from mvuav_ros.messages.images import BadFrame, Frame
from mvuav_ros.offline.replay.job import ReplaySettings, description
from mvuav_ros.offline.replay.pipeline import DEFECT, FrameResults, replay
from mvuav_ros.parameters.common_parameters import DetectorParameters
from mvuav_ros.processing.processor import Output, Processor, resolve
from mvuav_ros.recordings.stored_file import RecordedMessage
from mvuav_ros.vision.image import Image


class Node(Processor):
    """Says something of its own and something for everybody; stumbles at stamp 7."""

    name = 'node'
    parameters_type = DetectorParameters
    topics = {'own': PointCloud2, '/for_all': Header}
    debug_topics = ()
    periodic_topics = {'last': PointCloud2}
    resets = 0

    def configure(self, parameters: Any) -> None:
        pass

    def _forget(self) -> None:
        self.resets += 1

    def _process(self, frame: Frame, header: bytes) -> list[Output]:
        if frame.stamp_ns == 7:
            raise ZeroDivisionError('seven')
        return [Output('own', lambda: b'own'), Output('/for_all', lambda: b'all')]

    def draw(self, debug: Collection[str]) -> list[Output]:
        return []

    def periodic(self, header: bytes) -> list[Output]:
        return [Output('last', lambda: b'last')]


def frame(stamp_ns: int) -> Frame:
    return Frame(stamp_ns, 'camera', Image(np.zeros((2, 2), np.uint8), 'mono8'))


def test_topics_are_the_live_nodes() -> None:
    assert resolve('own') == '~/own'
    assert resolve('/for_all') == '/for_all'
    results, end = replay([frame(1)], [Node()])
    assert [message.topic for message in results.messages] == ['/node/own', '/for_all']
    assert [message.type for message in results.messages] == [
        'sensor_msgs/msg/PointCloud2',
        'std_msgs/msg/Header',
    ]
    assert [message.topic for message in end.messages] == ['/node/last']
    assert results.is_frame and not end.is_frame


def test_a_frame_without_a_result_has_its_reasons() -> None:
    message = RecordedMessage('/other', 'std_msgs/msg/Header', 2, b'')
    items = [frame(1), message, frame(1), BadFrame(3, 'torn'), frame(7), frame(8)]
    nodes = [Node(), Node()]
    first, copied, twice, torn, defect, good, end = replay(items, nodes)
    # As live, what a defect has left half done is forgotten.
    assert [node.resets for node in nodes] == [1, 1]
    assert first.reasons == good.reasons == []
    assert copied is message
    assert twice.reasons == ['the stamp of the frame before']
    assert torn == FrameResults(3, reasons=['torn'])
    assert defect.reasons == [f'{DEFECT} node: ZeroDivisionError: seven']
    assert end.stamp_ns == 8


def test_nothing_is_said_at_the_end_of_nothing() -> None:
    assert [step.reasons for step in replay([BadFrame(1, 'torn')], [Node()])] == [['torn']]


def test_a_simulated_flight_is_the_same_wherever_it_is_flown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = description('sim:tanker?frames=2', ReplaySettings({}))
    monkeypatch.chdir(tmp_path)
    assert description('sim:tanker?frames=2', ReplaySettings({})) == here

"""Images and curves to one page over a WebSocket, never faster than the page takes them."""

from __future__ import annotations

import asyncio
import json
import math
import struct
import time
from collections import Counter
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from mvuav_ros.panel.images import ImageFeed, Shot, streams_of
from mvuav_ros.panel.live_system import LiveSystem
from mvuav_ros.panel.ros_thread import RosThread
from mvuav_ros.panel.series import Point, SeriesFeed
from mvuav_ros.panel.sketch import Sketch

_CURVE_INTERVAL = 0.2
"""Seconds between two batches of points."""
MOST_STREAMS = 16
_LONGEST_REQUEST = 10_000
_UNANSWERED = 2
"""Images of one stream on their way; a slow link gets fewer images, not older ones."""


class LiveSocket:
    """One page's images and curves.

    The page says what is on its screen: ``{"images": [key, …], "series": node}``, and tells of
    each image that it has drawn it: ``{"drawn": key}``. It gets images as binary messages
    (uint32 length of a JSON header, the header, a JPEG), curves and the newest pose as JSON.
    """

    def __init__(
        self, socket: WebSocket, ros: RosThread, system: LiveSystem, feed: ImageFeed
    ) -> None:
        self._socket, self._ros, self._system, self._feed = socket, ros, system, feed
        self._looking: set[str] = set()
        self._waiting: dict[str, Shot] = {}
        self._under_way: Counter[str] = Counter()
        self._series: SeriesFeed | None = None
        self._series_of = ''
        self._points: list[Point] = []
        self._pose: Sketch | None = None
        self._something = asyncio.Event()
        self._sent_curves = 0.0

    async def run(self) -> None:
        """Serve the page until it is closed."""
        await self._socket.accept()
        sender = asyncio.create_task(self._send())
        try:
            while True:
                text = await self._socket.receive_text()
                if len(text) <= _LONGEST_REQUEST:
                    self._take(json.loads(text))
        except (WebSocketDisconnect, ValueError, TypeError, AttributeError, RecursionError):
            # Gone, or no page of ours.
            pass
        finally:
            sender.cancel()
            self._look_at([])
            self._follow('')

    def _take(self, request: dict[str, Any]) -> None:
        if 'drawn' in request:
            key = str(request['drawn'])
            if self._under_way[key] > 0:
                self._under_way[key] -= 1
                self._something.set()
        if 'images' in request:
            self._look_at([str(key) for key in request['images']])
        if 'series' in request:
            self._follow(str(request['series'] or ''))

    def _look_at(self, keys: list[str]) -> None:
        """Known streams only: what a page asks for never becomes a topic by itself."""
        streams = [each for node in self._system.nodes.values() for each in streams_of(node)]
        wanted = [each for each in streams if each.topic and each.key in keys][:MOST_STREAMS]
        looking = {stream.key for stream in wanted}
        for key in self._looking - looking:
            self._feed.look_away(key, self._arrived)
            self._waiting.pop(key, None)
            self._under_way.pop(key, None)
        for stream in wanted:
            self._feed.look(stream, self._arrived)
        self._looking = looking

    def _follow(self, name: str) -> None:
        node = self._system.nodes.get(name)
        name = node.name if node is not None else ''
        if name == self._series_of:
            return
        if self._series is not None:
            self._series.close()
        self._points.clear()
        self._pose = None
        self._series_of, self._series = name, None
        if node is not None:
            self._series = SeriesFeed(self._ros, node, self._point_arrived, self._pose_arrived)

    def _arrived(self, key: str, shot: Shot) -> None:
        self._waiting[key] = shot
        self._something.set()

    def _point_arrived(self, point: Point) -> None:
        self._points.append(point)
        self._something.set()

    def _pose_arrived(self, pose: Sketch) -> None:
        self._pose = pose
        self._something.set()

    async def _send(self) -> None:
        while True:
            await self._something.wait()
            self._something.clear()
            for key, shot in list(self._waiting.items()):
                if self._under_way[key] < _UNANSWERED:
                    self._waiting.pop(key, None)
                    self._under_way[key] += 1
                    await self._socket.send_bytes(_message(key, shot))
            now = time.monotonic()
            if (self._points or self._pose) and now - self._sent_curves >= _CURVE_INTERVAL:
                self._sent_curves = now
                points, self._points = self._points, []
                pose, self._pose = self._pose, None
                await self._socket.send_text(results_message(self._series_of, points, pose))


def _message(key: str, shot: Shot) -> bytes:
    words = f'{shot.rate:.1f} Hz' if math.isfinite(shot.rate) else ''
    words += f' · {shot.age_ms:.0f} ms' if math.isfinite(shot.age_ms) else ''
    header = {'key': key, 'width': shot.width, 'height': shot.height, 'words': words}
    text = json.dumps(header).encode()
    return struct.pack('<I', len(text)) + text + shot.jpeg


def results_message(node: str, points: list[Point], pose: Sketch | None) -> str:
    """As JSON: ``{"series": node, "points": [[time, chart, {curve: value}], …], "pose": …}``.

    A value that is not known is null.
    """
    rounded = [
        [
            round(time_s, 3),
            chart,
            {
                curve: round(value, 3) if math.isfinite(value) else None
                for curve, value in values.items()
            },
        ]
        for time_s, chart, values in points
    ]
    shown = {'numbers': pose.numbers, 'segments': pose.segments} if pose else None
    return json.dumps({'series': node, 'points': rounded, 'pose': shown})

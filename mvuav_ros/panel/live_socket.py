"""Images and curves to one page over a WebSocket, never faster than the page takes them."""

from __future__ import annotations

import asyncio
import json
import time
from collections import Counter
from typing import Any

from starlette.websockets import WebSocket

from mvuav_ros.panel.images import ImageFeed, streams_of
from mvuav_ros.panel.live_system import LiveSystem
from mvuav_ros.panel.ros_thread import RosThread
from mvuav_ros.panel.series import SeriesFeed

MOST_STREAMS = 16
_CURVE_INTERVAL = 0.2
"""Seconds between two batches of points."""
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
        self._waiting: dict[str, bytes] = {}
        self._under_way: Counter[str] = Counter()
        self._series: SeriesFeed | None = None
        self._something = asyncio.Event()

    async def run(self) -> None:
        """Serve the page until it is closed."""
        await self._socket.accept()
        sender = asyncio.create_task(self._send())
        try:
            async for text in self._socket.iter_text():
                if len(text) <= _LONGEST_REQUEST:
                    self._take(json.loads(text))
        except (ValueError, TypeError, AttributeError, RecursionError):
            # No page of ours.
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
        self._feed.look(self._arrived, set(wanted))
        known = self._waiting.keys() | self._under_way.keys()
        for key in known - {each.key for each in wanted}:
            self._waiting.pop(key, None)
            self._under_way.pop(key, None)

    def _follow(self, name: str) -> None:
        node = self._system.nodes.get(name)
        if self._series is not None and (node is None or self._series.name != name):
            self._series.close()
            self._series = None
        if self._series is None and node is not None:
            self._series = SeriesFeed(self._ros, node, self._something.set)

    def _arrived(self, key: str, message: bytes) -> None:
        self._waiting[key] = message
        self._something.set()

    async def _send(self) -> None:
        sent_curves = 0.0
        while True:
            await self._something.wait()
            self._something.clear()
            for key, message in list(self._waiting.items()):
                if self._under_way[key] < _UNANSWERED:
                    self._waiting.pop(key, None)
                    self._under_way[key] += 1
                    await self._socket.send_bytes(message)
            now = time.monotonic()
            if self._series is not None and now - sent_curves >= _CURVE_INTERVAL:
                text = self._series.take()
                if text:
                    sent_curves = now
                    await self._socket.send_text(text)

"""The panel's web application: the page, its files, its WebSocket, and the guard around them."""

from __future__ import annotations

import asyncio
import json
from collections import Counter
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from fastapi.responses import FileResponse, Response
from jinja2.ext import Extension
from nicegui import Client, app, core, ui
from nicegui.client import templates
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket

from mvuav_ros.panel.guard import NONCE, Guard
from mvuav_ros.panel.image_feed import MAX_STREAMS, streams_of
from mvuav_ros.panel.live_results import SeriesFeed
from mvuav_ros.panel.page.context import Services
from mvuav_ros.panel.page.view import PanelView

_CURVE_INTERVAL = 0.2
"""Seconds between two batches of points."""
_MAX_REQUEST = 10_000
_UNANSWERED = 2
"""Images of one stream on their way; a slow link gets fewer images, not older ones."""
_RECONNECT_TIME = 30.0
_TAB_MEMORY = 86_400.0
"""Seconds for which a browser tab's node, edits and ticks are kept."""


class LiveSocket:
    """One page's images and curves.

    The page says what is on its screen: ``{"images": [key, …], "series": node}``, and names
    each image that it has drawn: ``{"drawn": key}``. It gets images as binary messages
    (uint32 length of a JSON header, the header, a JPEG), curves and the newest pose as JSON.
    """

    def __init__(self, socket: WebSocket, services: Services) -> None:
        self._socket, self._services = socket, services
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
                if len(text) <= _MAX_REQUEST:
                    self._take(json.loads(text))
        except (LookupError, ValueError, TypeError, AttributeError, RuntimeError):
            # No page of ours, or one that went while something was sent to it.
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
        nodes = self._services.system.nodes.values()
        streams = [each for node in nodes for each in streams_of(node)]
        wanted = [each for each in streams if each.topic and each.key in keys][:MAX_STREAMS]
        self._services.feed.look(self._arrived, set(wanted))
        for kept in (self._waiting, self._under_way):
            for key in kept.keys() - {each.key for each in wanted}:
                del kept[key]

    def _follow(self, name: str) -> None:
        node = self._services.system.nodes.get(name)
        if self._series is not None and (node is None or self._series.name != name):
            self._series.close()
            self._series = None
        if self._series is None and node is not None:
            self._series = SeriesFeed(self._services.ros, node, self._something.set)

    def _arrived(self, key: str, message: bytes) -> None:
        self._waiting[key] = message
        self._something.set()

    async def _send(self) -> None:
        due_curves, loop = 0.0, asyncio.get_running_loop()
        while True:
            await self._something.wait()
            self._something.clear()
            for key, message in list(self._waiting.items()):
                if self._under_way[key] < _UNANSWERED:
                    self._waiting.pop(key, None)
                    self._under_way[key] += 1
                    await self._socket.send_bytes(message)
            if loop.time() < due_curves:
                # The rest of a frame's results, which nothing need follow.
                loop.call_at(due_curves, self._something.set)
            elif self._series is not None and (text := self._series.take()):
                due_curves = loop.time() + _CURVE_INTERVAL
                await self._socket.send_text(text)


_STATIC = Path(__file__).with_name('static')


def make_application(services: Services, token: str) -> Guard:
    """Everything that the web server serves; our own node spins while it does."""
    application = FastAPI(openapi_url=None)
    app.on_startup(services.ros.start)
    app.on_shutdown(services.end)

    @application.websocket('/live')
    async def live(socket: WebSocket) -> None:
        await LiveSocket(socket, services).run()

    @application.get('/report/{name}')
    def report(name: str) -> Response:
        path = services.runs.report(name)
        return FileResponse(path) if path else Response('there is no such report', 404)

    application.mount('/panel', StaticFiles(directory=_STATIC))
    stamp = max(int(path.stat().st_mtime) for path in _STATIC.iterdir())
    ui.add_head_html(
        f'<link rel="stylesheet" href="/panel/panel.css?{stamp}">'
        f'<script defer src="/panel/live.js?{stamp}"></script>',
        shared=True,
    )

    @ui.page('/', language='en-US')
    async def page(client: Client) -> None:
        # What nodes say goes over the WebSocket only; the page's own HTML holds nothing of it.
        await client.connected()
        await PanelView(services, client, app.storage.tab).images.restore()

    ui.run_with(
        application,
        title='Tuning panel',
        favicon=(_STATIC / 'icon.svg').read_text(),
        dark=None,
        tailwind=False,
        binding_refresh_interval=None,
        # A page on a slow link or machine comes back to its state instead of beginning anew.
        reconnect_timeout=_RECONNECT_TIME,
        show_welcome_message=False,
    )
    app.storage.max_tab_storage_age = _TAB_MEMORY
    templates.env.add_extension(_Nonce)
    templates.env.globals['csp_nonce'] = NONCE.get
    # NiceGUI answers pages of every origin; the guard asks for ours, and so does this.
    core.sio.eio.cors_allowed_origins = None
    return Guard(application, token)


class _Nonce(Extension):
    """Put into templates before any data are: data can never bring a script."""

    def preprocess(self, source: str, name: str | None, filename: str | None = None) -> str:
        return source.replace('<script', '<script nonce="{{ csp_nonce() }}"')

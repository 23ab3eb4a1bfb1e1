"""The panel's web application: the page, its files, its WebSocket, and the guard around them."""

from __future__ import annotations

from pathlib import Path

from fastapi import FastAPI, WebSocket
from fastapi.responses import FileResponse, Response
from jinja2.ext import Extension
from nicegui import Client, app, core, ui
from nicegui.client import templates
from starlette.staticfiles import StaticFiles

from mvuav_ros.panel.guard import NONCE, Guard
from mvuav_ros.panel.live_socket import LiveSocket
from mvuav_ros.panel.page.context import Services
from mvuav_ros.panel.page.view import View

_STATIC = Path(__file__).with_name('static')
_RECONNECT_TIME = 30.0
_TAB_MEMORY = 86_400.0
"""Seconds for which a browser tab's node, edits and ticks are kept."""


def make_application(services: Services, token: str) -> Guard:
    """Everything that the web server serves; our own node spins while it does."""
    application = FastAPI(openapi_url=None)
    app.on_startup(services.ros.start)

    @application.websocket('/live')
    async def live(socket: WebSocket) -> None:
        await LiveSocket(socket, services.ros, services.system, services.feed).run()

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
        await View(services, client, app.storage.tab).images.restore()

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

"""Who may talk to the panel: checked for every request and WebSocket before anything else runs."""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from contextvars import ContextVar
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

NONCE: ContextVar[str] = ContextVar('NONCE', default='')
"""Of the request that is being answered; scripts written in its page bear it, others do not run."""
_SAFE_METHODS = ('GET', 'HEAD')
_POLICY = (
    "default-src 'self'; script-src 'self' 'nonce-{nonce}' 'unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; "
    "object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
"""Vue compiles its templates in the page, hence eval; other hosts are never asked."""

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]


def is_loopback(host: str) -> bool:
    """Whether an address reaches this machine only."""
    if host == 'localhost':
        return True
    try:
        return ipaddress.ip_address(host.strip('[]')).is_loopback
    except ValueError:
        return False


def make_token(host: str) -> str:
    """A new secret for a panel that others on the network can reach; empty on loopback."""
    return '' if is_loopback(host) else secrets.token_urlsafe(24)


@dataclass(frozen=True)
class Refusal:
    """An answer instead of the page."""

    status: int
    words: str


class Guard:
    """ASGI application around another one that answers only those who may.

    On loopback only names of this machine are served, so that a foreign page cannot reach the
    panel by having its own name resolve to 127.0.0.1. Elsewhere a token is asked for; given once
    in the address, it is kept in a cookie. What comes from a page (a WebSocket, any method that
    changes something) must come from a page of ours.
    """

    def __init__(self, app: App, token: str) -> None:
        """Put a guard in front of an application.

        Args:
            app: the application.
            token: what a visitor must know; empty on loopback.
        """
        self.app = app
        self._token = token
        # Browsers send a cookie to every port of a host: each panel's has a name of its own.
        self.cookie = f'tuning_panel_{hashlib.sha256(token.encode()).hexdigest()[:12]}'

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """See ASGI."""
        if scope['type'] not in ('http', 'websocket'):
            await self.app(scope, receive, send)
            return
        NONCE.set(secrets.token_urlsafe(16))
        headers = {name.decode('latin-1'): value for name, value in scope['headers']}
        headers = {name: value.decode('latin-1') for name, value in headers.items()}
        given = parse_qs(scope.get('query_string', b'').decode('latin-1')).get('token', [''])[0]
        refusal = self.refusal(scope['type'], scope.get('method', 'GET'), headers, given)
        if refusal is not None:
            await _refuse(scope['type'], refusal, receive, send)
        elif scope['type'] == 'http' and self._token and given:
            await _answer(send, 303, b'', [(b'location', b'/'), (b'set-cookie', self._cookie())])
        elif scope['type'] == 'http':
            await self.app(scope, receive, _with_headers(send))
        else:
            await self.app(scope, receive, send)

    def refusal(
        self, kind: str, method: str, headers: MutableMapping[str, str], given: str = ''
    ) -> Refusal | None:
        """Why a visitor is turned away; None where he is not.

        Args:
            kind: ``http`` or ``websocket``.
            method: of the request.
            headers: with names in lower case.
            given: the token in the address.
        """
        host = headers.get('host', '')
        if not self._token and not is_loopback(_name_of(host)):
            return Refusal(403, f'{host or "no host"} is not a name of this machine')
        origin = headers.get('origin')
        changes = kind == 'websocket' or method not in _SAFE_METHODS
        if changes and (origin is None or not _same_origin(origin, host)):
            return Refusal(403, 'the request comes from a page of another site')
        if self._token and not self._knows(given) and not self._knows(self._kept(headers)):
            return Refusal(401, 'open the address with ?token= that the panel printed')
        return None

    def _knows(self, given: str) -> bool:
        return hmac.compare_digest(given.encode('latin-1', 'replace'), self._token.encode())

    def _cookie(self) -> bytes:
        return f'{self.cookie}={self._token}; HttpOnly; SameSite=Strict; Path=/'.encode()

    def _kept(self, headers: MutableMapping[str, str]) -> str:
        try:
            cookies = SimpleCookie(headers.get('cookie', ''))
        except CookieError:
            return ''
        return cookies[self.cookie].value if self.cookie in cookies else ''


def _name_of(host: str) -> str:
    try:
        return urlsplit(f'//{host}').hostname or ''
    except ValueError:
        return ''


def _same_origin(origin: str, host: str) -> bool:
    try:
        parts = urlsplit(origin)
    except ValueError:
        return False
    return parts.scheme in ('http', 'https') and parts.netloc.lower() == host.lower()


def _headers() -> list[tuple[bytes, bytes]]:
    return [
        (b'content-security-policy', _POLICY.format(nonce=NONCE.get()).encode()),
        (b'x-content-type-options', b'nosniff'),
        (b'referrer-policy', b'no-referrer'),
    ]


def _with_headers(send: Send) -> Send:
    async def send_more(message: MutableMapping[str, Any]) -> None:
        if message['type'] == 'http.response.start':
            message['headers'] = [*message.get('headers', ()), *_headers()]
        await send(message)

    return send_more


async def _refuse(kind: str, refusal: Refusal, receive: Receive, send: Send) -> None:
    if kind == 'websocket':
        await receive()
        await send({'type': 'websocket.close', 'code': 1008, 'reason': refusal.words})
        return
    await _answer(send, refusal.status, f'{refusal.words}\n'.encode(), [])


async def _answer(send: Send, status: int, body: bytes, more: list[tuple[bytes, bytes]]) -> None:
    headers = [(b'content-type', b'text/plain; charset=utf-8'), *_headers(), *more]
    headers.append((b'content-length', str(len(body)).encode()))
    await send({'type': 'http.response.start', 'status': status, 'headers': headers})
    await send({'type': 'http.response.body', 'body': body})

"""Who may talk to the panel: checked for every request and WebSocket before anything else runs."""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import re
import secrets
from contextvars import ContextVar

from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

NONCE: ContextVar[str] = ContextVar('NONCE', default='')
"""Of the request that is being answered; scripts written in its page bear it, others do not run."""
_MAX_BODY = 1_000_000
"""Bytes; a page sends nothing larger than a set of parameters."""
_PORT = re.compile(r':\d+$')
_POLICY = (
    "default-src 'self'; script-src 'self' 'nonce-{nonce}' 'unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; "
    "object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
"""Vue compiles its templates in the page, hence eval; other hosts are never asked."""


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


class Guard:
    """ASGI application around another one that answers only those who may.

    On loopback only names of this machine are served, so that a page of others cannot reach the
    panel by having its own name resolve to 127.0.0.1. Elsewhere a token is asked for; given once
    in the address, it is kept in a cookie. What comes from a page (a WebSocket, any method that
    changes something) must come from a page of ours.
    """

    def __init__(self, app: ASGIApp, token: str) -> None:
        """Put a guard in front of an application; the token is empty on loopback."""
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
        visitor = HTTPConnection(scope)
        given = visitor.query_params.get('token', '')
        answer = self._refusal(visitor, given)
        if answer is None and scope['type'] == 'http' and self._token and given:
            # The token does not stay in the address bar and its history.
            cookie = f'{self.cookie}={self._token}; HttpOnly; SameSite=Strict; Path=/'
            answer = RedirectResponse('/', 303, {'set-cookie': cookie})
        if answer is not None and scope['type'] == 'websocket':
            # A page would be an error of ours in the server's log.
            await send({'type': 'websocket.close', 'code': 1008, 'reason': 'refused'})
            return
        try:
            await (answer or self.app)(scope, receive, _with_headers(send))
        except RuntimeError as error:
            # What Starlette makes of a page that is left or loaded again before it is answered.
            if str(error) != 'No response returned.':
                raise

    def _refusal(self, visitor: HTTPConnection, token: str) -> Response | None:
        """The answer to a visitor with this token who is turned away; None where he is not."""
        host, origin = visitor.headers.get('host', ''), visitor.headers.get('origin')
        if not self._token and not is_loopback(_PORT.sub('', host.lower())):
            return PlainTextResponse(f'{host or "no host"} is not a name of this machine\n', 403)
        scope = visitor.scope
        if not scope['path'].isprintable():
            # What is not found is logged; escape codes from any site's link reach the terminal.
            return PlainTextResponse('there is no such page\n', 404)
        is_http = scope['type'] == 'http'
        reads = is_http and scope['method'] in ('GET', 'HEAD')
        ours = (f'http://{host}'.lower(), f'https://{host}'.lower())
        if not reads and (origin or '').lower() not in ours:
            return PlainTextResponse('the request comes from a page of another site\n', 403)
        given = (token, visitor.cookies.get(self.cookie, ''))
        own = self._token.encode()
        if own and not any(hmac.compare_digest(t.encode('utf-8', 'replace'), own) for t in given):
            words = 'open the address with ?token= that the panel printed\n'
            return PlainTextResponse(words, 401)
        size = visitor.headers.get('content-length', '')
        if is_http and not reads and not (size.isdecimal() and int(size[:20]) <= _MAX_BODY):
            return PlainTextResponse(f'a request has at most {_MAX_BODY} bytes, and says so\n', 413)
        return None


def _with_headers(send: Send) -> Send:
    headers = [
        (b'content-security-policy', _POLICY.format(nonce=NONCE.get()).encode()),
        (b'x-content-type-options', b'nosniff'),
        (b'referrer-policy', b'no-referrer'),
    ]

    async def send_more(message: Message) -> None:
        # Of a refused WebSocket too: websocket.http.response.start.
        if message['type'].endswith('http.response.start'):
            message['headers'] = [*message.get('headers', ()), *headers]
        await send(message)

    return send_more

"""Who may talk to the panel."""

import asyncio

import pytest

pytest.importorskip('nicegui', reason='the extra panel is not installed')

from mvuav_ros.panel.guard import Guard, is_loopback, make_token

TOKEN = 'a-token-that-only-we-know'


async def inner(scope, receive, send):
    if scope['type'] == 'http':
        await send({'type': 'http.response.start', 'status': 200, 'headers': []})
        await send({'type': 'http.response.body', 'body': b'inside'})
    else:
        await send({'type': 'websocket.accept'})


COOKIE = Guard(inner, TOKEN).cookie


def ask(token='', kind='http', method='GET', query='', path='/', **headers):
    """What a guarded application sends back."""
    sent = []

    async def receive():
        return {'type': f'{kind}.connect'}

    async def send(message):
        sent.append(message)

    named = {'host': 'localhost:8642', **headers}
    scope = {
        'type': kind,
        'method': method,
        'path': path,
        'query_string': query.encode(),
        'headers': [(k.encode(), v.encode('latin-1')) for k, v in named.items() if v is not None],
    }
    asyncio.run(Guard(inner, token)(scope, receive, send))
    return sent


def status(*arguments, **more):
    return ask(*arguments, **more)[0]['status']


def is_accepted(**more):
    (answer,) = ask(kind='websocket', **more)
    # No page, which the server would log as an error.
    assert answer['type'] in ('websocket.accept', 'websocket.close')
    return bool(answer['type'] == 'websocket.accept')


@pytest.mark.parametrize('host', ['LocalHost:8642', '127.0.0.1:8642', '[::1]:8642', '127.0.0.1'])
def test_loopback_serves_the_names_of_this_machine(host):
    assert status(host=host) == status(host=host, query='token=of_another_panel') == 200
    assert is_accepted(host=host, origin=f'http://{host}')


@pytest.mark.parametrize('path', ['/x\x1b[2J', '/x\nforged', '/\u202eegap'])
def test_what_would_spoil_the_log_is_not_even_looked_for(path):
    (start, body) = ask(path=path)
    assert start['status'] == 404 and body['body'] == b'there is no such page\n'
    assert status(path='/report/night 1') == 200


@pytest.mark.parametrize(
    'host', ['evil.example:8642', '192.168.1.7:8642', '', None, '127.0.0.1.evil.example', '[']
)
def test_loopback_does_not_serve_a_foreign_name_that_resolves_to_it(host):
    assert status(host=host) == 403
    assert not is_accepted(host=host, origin=f'http://{host}')


@pytest.mark.parametrize(
    'origin',
    [
        None,
        'null',
        'http://evil.example',
        'http://localhost:9999',
        'http://localhost',
        'http://evil.example/localhost:8642',
        'http://localhost:8642@evil.example',
        'ftp://localhost:8642',
        'http://[',
    ],
)
def test_a_websocket_or_post_from_another_page_is_refused(origin):
    assert not is_accepted(origin=origin)
    for method in ('POST', 'PUT', 'DELETE'):
        assert status(method=method, origin=origin) == 403
    cookie = f'{COOKIE}={TOKEN}'
    assert not is_accepted(token=TOKEN, origin=origin, cookie=cookie)


def test_what_is_larger_than_any_page_sends_is_refused_before_it_is_received():
    ours = {'method': 'POST', 'origin': 'http://localhost:8642'}
    sizes = {'0': 200, '1000000': 200, '1000001': 413, '9' * 5000: 413, '-1': 413, None: 413}
    assert {size: status(**ours, **{'content-length': size}) for size in sizes} == sizes
    assert status() == 200 and is_accepted(origin='http://localhost:8642')


def test_elsewhere_a_token_is_asked_for_and_then_kept_in_a_cookie():
    host = 'robot:8642'
    assert status(TOKEN, host=host) == 401
    assert status(TOKEN, host=host, query='token=wrong') == 401
    assert status(TOKEN, host=host, query='token=') == 401
    assert status(TOKEN, host=host, cookie=f'{COOKIE}=wrong') == 401
    assert status(TOKEN, host=host, cookie=f'{COOKIE}=\xff"') == 401
    assert not is_accepted(token=TOKEN, host=host, origin=f'http://{host}')
    answer = ask(TOKEN, host=host, query=f'token={TOKEN}')[0]
    headers = dict(answer['headers'])
    # The token does not stay in the address bar and its history.
    assert (answer['status'], headers[b'location']) == (303, b'/')
    cookie = headers[b'set-cookie'].decode()
    assert 'HttpOnly' in cookie and 'SameSite=Strict' in cookie
    kept = cookie.split(';')[0]
    assert status(TOKEN, host=host, cookie=kept) == 200
    assert is_accepted(token=TOKEN, host=host, origin=f'http://{host}', cookie=kept)


def test_answers_forbid_other_hosts_and_frames():
    headers = dict(ask()[0]['headers'])
    policy = headers[b'content-security-policy'].decode()
    assert "default-src 'self'" in policy and "frame-ancestors 'none'" in policy
    assert 'http' not in policy


def test_scripts_run_only_with_the_nonce_of_their_page():
    policies = {dict(ask()[0]['headers'])[b'content-security-policy'].decode() for _ in range(5)}
    assert len(policies) == 5
    for policy in policies:
        (scripts,) = [part for part in policy.split(';') if 'script-src' in part]
        assert 'unsafe-inline' not in scripts and "'nonce-" in scripts


def test_two_panels_on_one_machine_have_cookies_of_their_own():
    assert Guard(inner, 'one').cookie != Guard(inner, 'other').cookie


def test_only_loopback_goes_without_a_token():
    assert [make_token(host) for host in ('127.0.0.1', 'localhost', '::1')] == ['', '', '']
    tokens = {make_token('0.0.0.0') for _ in range(20)}
    assert len(tokens) == 20 and all(len(token) >= 32 for token in tokens)
    assert not is_loopback('robot') and not is_loopback('127.0.0.1.evil.example')


def test_a_page_that_is_left_before_its_answer_is_no_defect():
    async def ended(scope, receive, send):
        # As Starlette does, once the visitor is gone.
        raise RuntimeError(scope['reason'])

    scope = {'type': 'http', 'method': 'GET', 'path': '/', 'query_string': b''}
    scope['headers'] = [(b'host', b'localhost')]
    asyncio.run(Guard(ended, '')({**scope, 'reason': 'No response returned.'}, None, None))
    with pytest.raises(RuntimeError, match='another'):
        asyncio.run(Guard(ended, '')({**scope, 'reason': 'another'}, None, None))

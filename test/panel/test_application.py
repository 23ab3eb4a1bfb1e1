"""What the panel sends to a page."""

import asyncio
from types import SimpleNamespace

import pytest

pytest.importorskip('nicegui', reason='the extra panel is not installed')

from starlette.websockets import WebSocket

from mvuav_ros.panel.application import LiveSocket


class Series:
    """A node whose frames come one by one, with long pauses."""

    name, news = 'node', ''

    def take(self):
        taken, self.news = self.news, ''
        return taken


def test_the_last_results_of_a_frame_are_sent_without_waiting_for_the_next_frame():
    async def follow():
        sent, series = [], Series()

        class Socket:
            async def send_text(self, text):
                sent.append(text)

        live = LiveSocket(Socket(), None)
        live._series = series
        sender = asyncio.create_task(live._send())
        async with asyncio.timeout(20.0):
            for words in ('markers', 'pose'):
                series.news = words
                live._something.set()
                while words not in sent:
                    await asyncio.sleep(0.01)
        sender.cancel()
        return sent

    assert asyncio.run(follow()) == ['markers', 'pose']


def test_a_page_that_goes_while_an_image_is_sent_to_it_is_no_error():
    async def go():
        gone = asyncio.Event()
        messages = [{'type': 'websocket.receive', 'text': '{}'}, {'type': 'websocket.connect'}]

        async def receive():
            if len(messages) == 1:
                live._arrived('image', b'')
                await gone.wait()
            return messages.pop()

        async def send(message):
            if message['type'] == 'websocket.send':
                gone.set()
                raise OSError

        services = SimpleNamespace(
            system=SimpleNamespace(nodes={}), feed=SimpleNamespace(look=lambda *_: None)
        )
        live = LiveSocket(WebSocket({'type': 'websocket'}, receive, send), services)
        async with asyncio.timeout(20.0):
            await live.run()
        return messages

    assert asyncio.run(go()) == []

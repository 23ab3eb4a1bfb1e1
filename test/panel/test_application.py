"""What the panel sends to a page."""

import asyncio

import pytest

pytest.importorskip('nicegui', reason='the extra panel is not installed')

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

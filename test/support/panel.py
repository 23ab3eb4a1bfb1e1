"""A running tuning panel, its nodes, and the browser that looks at it."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from support.graph import CLEAN, ROOT, Graph

pytest.importorskip('nicegui', reason='the extra panel is not installed')
sync_api = pytest.importorskip('playwright.sync_api', reason='playwright is not installed')
CHROMIUM = shutil.which('chromium') or shutil.which('chromium-browser')
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason='there is no chromium here')

TRACKER, DETECTOR = '/marker_tracker', '/runway_detector'
PATIENCE = 180.0
"""Seconds; nothing takes as long, but a loaded machine may."""


class Panel:
    """A running panel and its nodes; ``open`` gives it a page."""

    def __init__(self, graph, folder, *options):
        self.graph = graph
        self.tracker = graph.start('marker_tracker', remap=('image_raw:=/tanker/image_raw',))
        graph.start('runway_detector', remap=('image_raw:=/runway/image_raw',))
        for name in ('tanker', 'runway'):
            bag = ROOT / 'bags' / f'{name}.mcap'
            graph.spawn('video_source', remap=(f'__ns:=/{name}',), source=bag, loop='true')
        self.log = folder / 'log'
        command = [sys.executable, '-m', 'mvuav_ros', 'tuning_panel', '--port', '0']
        self.process = subprocess.Popen(
            [*command, '--folder', folder, *options],
            cwd=ROOT,
            env={**CLEAN, 'ROS_DOMAIN_ID': str(graph.domain_id)},
            stdout=subprocess.PIPE,
            stderr=self.log.open('w'),
            text=True,
        )
        self.url = self.process.stdout.readline().split()[-1]
        self.folder = folder
        self.requests = []
        self.errors = []

    def new_page(self, width=1280, height=900, scheme='light'):
        context = self.browser.new_context(
            viewport={'width': width, 'height': height}, color_scheme=scheme
        )
        page = context.new_page()
        page.set_default_timeout(PATIENCE * 1000)
        page.on('request', lambda request: self.requests.append(request.url))
        page.on('pageerror', lambda error: self.errors.append(str(error)))
        page.on('console', self._hear)
        page.goto(self.url)
        return page

    def _hear(self, message):
        if message.type == 'error' or 'Content Security Policy' in message.text:
            self.errors.append(message.text)

    def open(self):
        self.page = self.new_page()
        self.choose(TRACKER)

    def until(self, condition, what):
        self.graph.until(condition, what, PATIENCE)

    def choose(self, node, page=None):
        page = page or self.page
        page.locator('.node', has_text=node).click()
        name = 'threshold' if node == TRACKER else 'num_peaks'
        self.row(name, page).wait_for(state='attached')

    def part(self, name, page=None):
        (page or self.page).locator(f'.q-tab.{name}').click()

    def row(self, name, page=None):
        return (page or self.page).locator(f'[data-parameter="{name}"]')

    def now(self, name, page=None):
        return self.row(name, page).locator('.now').inner_text()

    def enter(self, name, value, page=None):
        field = self.row(name, page).locator('.edit input').first
        field.fill(str(value))
        field.press('Enter')

    def said(self):
        """What the panel's process has written to its terminal."""
        return self.log.read_text()

    def close(self):
        self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(timeout=120)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


@contextmanager
def open_panel(folder, *options) -> Iterator[Panel]:
    """Everything, until the end of the ``with``."""
    graph = Graph()
    panel = None
    try:
        panel = Panel(graph, folder, *options)
        with sync_api.sync_playwright() as playwright:
            panel.browser = playwright.chromium.launch(
                executable_path=CHROMIUM, args=['--no-sandbox', '--disable-dev-shm-usage']
            )
            panel.open()
            yield panel
            panel.browser.close()
    finally:
        if panel is not None:
            panel.close()
        graph.close()

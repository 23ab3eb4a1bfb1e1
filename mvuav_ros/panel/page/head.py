"""The page's head: the nodes to choose from, and how the chosen one does."""

from __future__ import annotations

from nicegui import ui

from mvuav_ros.panel.live_system import LiveNode
from mvuav_ros.panel.page.context import Page
from mvuav_ros.panel.page.elements import box, icon_button, text

_FIGURES = {
    'input_rate_hz': ('in', 'Hz'),
    'output_rate_hz': ('out', 'Hz'),
    'latency_p50_ms': ('latency p50', 'ms'),
    'latency_p95_ms': ('p95', 'ms'),
    'frames_refused': ('refused', ''),
}


class Head:
    """Node buttons and the chosen node's diagnostics."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._dark = ui.dark_mode(value=None)
        with box('head', 'header'):
            text('Tuning panel', tag='h1')
            self._nodes = box('nodes grow').props('role=group aria-label="Nodes"')
            icon_button('contrast', 'Light or dark', self._toggle)
        with box('health'):
            self._figures = {}
            for key, (words, unit) in _FIGURES.items():
                with box():
                    text(words, 'soft small')
                    self._figures[key] = text('-', 'number')
                    text(unit, 'soft small')
            self._words = text('', 'words soft small')
        self._shown: list[tuple[str, bool, bool, int]] = []
        page.on_select.append(self.refresh)
        self.refresh()

    async def _toggle(self) -> None:
        dark = await ui.run_javascript('return document.body.classList.contains("body--dark")')
        self._dark.value = not dark

    def refresh(self) -> None:
        """After nodes came or went, or another was selected."""
        nodes = list(self._page.services.system.nodes.values())
        alive = [node for node in nodes if node.alive]
        if self._page.node is None and nodes:
            self._page.select((alive or nodes)[0].name)
            return
        shown = [(n.name, n.alive, n.name == self._page.selected, n.level) for n in nodes]
        if shown != self._shown or not nodes:
            self._shown = shown
            self._nodes.clear()
            with self._nodes:
                for node in nodes:
                    self._button(node)
                if not nodes:
                    text('looking for nodes …', 'soft')
        self.show_status()

    def _button(self, node: LiveNode) -> None:
        chosen = node.name == self._page.selected
        made = box('node', 'button').props(f'type=button aria-pressed={str(chosen).lower()}')
        made.on('click', lambda: self._page.select(node.name))
        with made:
            box('dot ' + ('bad' if not node.alive else 'warn' if node.level else 'good'))
            text(node.name)
            if not node.alive:
                text('starting' if not node.controls else 'gone', 'state')

    def show_status(self) -> None:
        """After new diagnostics."""
        node = self._page.node
        status = node.status if node is not None and node.alive else {}
        for key, label in self._figures.items():
            value = status.get(key, '-')
            label.set_text('-' if value == 'nan' else value)
        if node is None:
            words = 'Start marker_tracker or runway_detector; it appears here by itself.'
        elif not node.alive and node.controls:
            words = 'The node is gone. It is taken up again as soon as it is back.'
        else:
            words = node.message
        self._words.set_text(words)

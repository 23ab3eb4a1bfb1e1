"""The page's head: the nodes to choose from, and how the chosen one does."""

from __future__ import annotations

from nicegui import ui

from mvuav_ros.panel.page.context import Page
from mvuav_ros.panel.page.elements import box, icon_button, set_props, text

_FIGURES = {
    'input_rate_hz': ('in', 'Hz'),
    'output_rate_hz': ('out', 'Hz'),
    'latency_p50_ms': ('latency p50', 'ms'),
    'latency_p95_ms': ('p95', 'ms'),
    'frames_rejected': ('rejected', ''),
}


class Head:
    """Node buttons and the chosen node's diagnostics."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._dark = ui.dark_mode(value=None)
        self._buttons: dict[str, ui.button] = {}
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

    async def _toggle(self) -> None:
        dark = await ui.run_javascript('return document.body.classList.contains("body--dark")')
        self._dark.value = not dark

    def _node_button(self, name: str) -> ui.button:
        made = ui.button(name, icon='circle', color=None)
        return made.props('flat rounded no-caps').on_click(lambda: self._page.select(name))

    def refresh(self) -> None:
        """After nodes came or went, were selected, or said something."""
        nodes = self._page.services.system.nodes
        alive = [name for name, node in nodes.items() if node.alive]
        # What was chosen before a reload may need a moment to be found again.
        if self._page.node is None and nodes and (alive or not self._page.selected):
            self._page.select((alive or list(nodes))[0])
            return
        if list(nodes) != list(self._buttons) or not nodes:
            # Only then: a button that is made anew loses the keyboard's focus.
            self._nodes.clear()
            with self._nodes:
                self._buttons = {name: self._node_button(name) for name in nodes}
                if not nodes:
                    text('looking for nodes …', 'soft')
        for name, button in self._buttons.items():
            each = nodes[name]
            state = '' if each.alive else 'gone' if each.controls else 'starting'
            color = 'bad' if state == 'gone' else 'warn' if state or each.level else 'good'
            button.set_text(f'{name} {state}'.rstrip())
            button.classes(replace=f'node {color}')
            set_props(button, aria_pressed=str(name == self._page.selected).lower())
        node = self._page.node
        for key, label in self._figures.items():
            value = node.status.get(key, '-') if node is not None and node.alive else '-'
            label.set_text('-' if value == 'nan' else value[:12])
        if node is None:
            words = 'Start marker_tracker or runway_detector; it appears here by itself.'
        elif not node.alive and node.controls:
            words = 'The node is gone. The panel uses it again as soon as it is back.'
        else:
            words = node.message
        self._words.set_text(words)

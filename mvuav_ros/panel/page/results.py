"""The part with the chosen node's results: flags, statistics and live curves."""

from __future__ import annotations

from collections.abc import Mapping

from nicegui import ui

from mvuav_ros.panel import foreign
from mvuav_ros.panel.live_node import LiveNode
from mvuav_ros.panel.page import elements as el
from mvuav_ros.panel.page.context import Page
from mvuav_ros.panel.series import CURVES

_COUNTS = {'rho_flags': 'rho flags', 'theta_flags': 'theta flags', 'combined_flags': 'combined'}
_MEANS = {
    'rho_mean': 'mean rho px',
    'rho_std': 'std',
    'theta_mean_deg': 'mean theta °',
    'theta_std_deg': 'std',
}


class Results:
    """A node's tables and charts; curves come over the page's own WebSocket."""

    def __init__(self, page: Page, node: LiveNode) -> None:
        self._page, self._node = page, node
        self._lines: ui.table | None = None
        if node.kind == 'runway_detector':
            with el.box('card'):
                with el.box('line titled'):
                    el.text('Statistics since the last reset', 'title grow', tag='h2')
                    el.button('Reset', self._reset, 'restart_alt')
                heads = ('line', 'frames', *_COUNTS.values(), *_MEANS.values())
                self._lines = el.sheet('Statistics of the lines', heads)
        with el.box('charts'):
            for chart, (title, unit) in CURVES[node.kind].items():
                with el.box('card'):
                    made = ui.echart(el.axes(title, unit)).classes('chart')
                    # Until the first value there is nothing that the chart would say of itself.
                    el.set_props(made, aria_label=f'Curve of {title}')
                    el.set_props(made, data_curves=chart, data_node=node.name)
        with el.box('card'):
            el.text('Diagnostics of the node', tag='h2')
            with el.box('charts'):
                self._said = [el.sheet(f'Diagnostics, {half}', ('', '')) for half in ('one', 'two')]
        self.show()

    def show(self) -> None:
        """After new statistics or diagnostics."""
        said = self._node.status
        if self._lines:
            el.fill(self._lines, _statistics_rows(self._node.statistics))
        rows = [(name.replace('_', ' '), value) for name, value in said.items()]
        half = -(-len(rows) // 2)
        for table, part in zip(self._said, (rows[:half], rows[half:]), strict=True):
            el.fill(table, part)

    async def _reset(self) -> None:
        reason = await self._page.services.system.trigger(f'{self._node.name}/reset_statistics')
        if reason:
            el.tell(reason, bad=True)


def _statistics_rows(said: Mapping[str, Mapping[str, str]]) -> list[list[str]]:
    """All lines, and each; numbered from 1, as in the images."""

    def row(name: str, values: Mapping[str, str], frames: str) -> list[str]:
        counts = [foreign.fixed(values.get(key), 0) for key in (frames, *_COUNTS)]
        means = [foreign.fixed(values[key], 2) if key in values else '' for key in _MEANS]
        return [name, *counts, *means]

    lines = [row(name, said[name], 'found') for name in said if name.startswith('line ')]
    return [row('all lines', said.get('runway', {}), 'frames'), *lines]

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
_FRAMES = {
    'frames_received': 'received',
    'frames_processed': 'processed',
    'frames_rejected': 'rejected',
    'frames_skipped': 'skipped',
    'frames_lost_in_transport': 'lost in transport',
    'frames_missing': 'missing',
    'stamp_jumps_back': 'stamps jumped back',
}
_TIMES = {
    'transport_p50_ms': 'transport, median [ms]',
    'decode_p50_ms': 'decode, median [ms]',
    'process_p50_ms': 'process, median [ms]',
    'publish_p50_ms': 'publish, median [ms]',
    'latency_p95_ms': 'whole, p95 [ms]',
    'latency_p99_ms': 'whole, p99 [ms]',
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
        with el.box('charts'):
            with el.box('card'):
                el.text('Frames', tag='h2')
                self._frames = el.sheet('Frames', ('', ''))
            with el.box('card'):
                el.text('Time per frame', tag='h2')
                self._times = el.sheet('Time per frame', ('', ''))
        self.show()

    def show(self) -> None:
        """After new statistics or diagnostics."""
        said = self._node.status
        if self._lines:
            el.fill(self._lines, _statistics_rows(self._node.statistics))
        el.fill(self._frames, [(words, said.get(key, '-')) for key, words in _FRAMES.items()])
        times = _TIMES.items()
        el.fill(self._times, [(words, foreign.fixed(said.get(key), 2)) for key, words in times])

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

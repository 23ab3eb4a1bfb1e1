"""The part with the chosen node's results: flags, statistics and live curves."""

from __future__ import annotations

from nicegui import ui

from mvuav_ros.panel.page.context import Page
from mvuav_ros.panel.page.elements import axes, box, button, empty, tell, text
from mvuav_ros.panel.series import CURVES

_TOTALS = {
    'frames': 'frames',
    'rho_flags': 'rho flags',
    'theta_flags': 'theta flags',
    'combined_flags': 'combined',
}
_COLUMNS = {
    'found': 'frames',
    'rho_flags': 'rho flags',
    'theta_flags': 'theta flags',
    'combined_flags': 'combined',
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
_TIMES = ('transport', 'decode', 'process', 'publish')


class Results:
    """Tables and charts; the curves come over the page's own WebSocket."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._cells: dict[tuple[str, str], ui.label] = {}
        self._built: tuple[object, ...] = ()
        self._table_place: ui.element
        self._place = box('part results', 'section').props('aria-label=Results')
        page.on_select.append(self.refresh)
        self.refresh()

    def refresh(self) -> None:
        """Build anew where another node is chosen or it has more lines."""
        node = self._page.node
        built = (node.name, tuple(node.statistics)) if node is not None else ()
        if built == self._built and self._cells:
            return
        same = bool(self._cells) and built[:1] == self._built[:1]
        self._built = built
        if same:
            self._cells = {key: cell for key, cell in self._cells.items() if not key[0]}
            self._table_place.clear()
            with self._table_place:
                self._statistics()
            self.show()
            return
        self._cells = {}
        self._place.clear()
        with self._place:
            if node is None:
                with box('card'):
                    empty('No results yet', 'They appear as soon as a node runs.')
                return
            with box('stack'):
                self._table_place = box('stack')
                with self._table_place:
                    self._statistics()
                with box('charts'):
                    self._charts(node.name, node.kind)
                self._diagnostics()
        self.show()

    def _statistics(self) -> None:
        node = self._page.node
        if node is None or node.kind != 'runway_detector':
            return
        lines = [name for name in node.statistics if name.startswith('line')]
        with box('card'):
            with box('line').style('padding: 8px 8px 4px 14px'):
                text('Statistics since the last reset', 'title grow')
                button('Reset', self._reset, 'restart_alt')
            with box('scroll'), box('sheet', 'table'):
                with box(tag='thead'), box(tag='tr'):
                    text('', tag='th')
                    for words in _COLUMNS.values():
                        text(words, tag='th')
                with box(tag='tbody'):
                    self._total_row()
                    for line in lines:
                        self._row(line, line, _COLUMNS)

    def _total_row(self) -> None:
        keys = {'frames': '', **{key: '' for key in _TOTALS if key != 'frames'}}
        self._row('runway', 'all lines', keys, len(_COLUMNS) - len(keys))

    def _row(self, status: str, title: str, keys: dict[str, str], blank: int = 0) -> None:
        with box(tag='tr'):
            text(title, tag='td')
            for key in keys:
                self._cells[status, key] = text('-', tag='td')
            for _ in range(blank):
                text('', tag='td')

    def _charts(self, name: str, kind: str) -> None:
        for chart, (title, unit) in CURVES[kind].items():
            with box('card'):
                made = ui.echart(axes(title, unit, seconds=True)).classes('chart')
                made.props['data-curves'] = chart
                made.props['data-node'] = name

    def _diagnostics(self) -> None:
        with box('charts'):
            with box('card'):
                text('Frames', tag='h2')
                with box('sheet', 'table').style('margin: 6px 0 4px'), box(tag='tbody'):
                    for key, words in _FRAMES.items():
                        self._row('', words, {key: ''})
            with box('card'):
                text('Time per frame, median', tag='h2')
                with box('sheet', 'table').style('margin: 6px 0 4px'), box(tag='tbody'):
                    for stage in _TIMES:
                        self._row('', f'{stage} [ms]', {f'{stage}_p50_ms': ''})
                    self._row('', 'whole, p95 [ms]', {'latency_p95_ms': ''})
                    self._row('', 'whole, p99 [ms]', {'latency_p99_ms': ''})

    def show(self) -> None:
        """After new statistics or diagnostics."""
        node = self._page.node
        if node is None:
            return
        for (status, key), label in self._cells.items():
            values = node.statistics.get(status, {}) if status else node.status
            label.set_text(_words(key, values.get(key, '-')))

    async def _reset(self) -> None:
        reason = await self._page.services.system.trigger(f'{self._page.selected}/reset_statistics')
        if reason:
            tell(reason, bad=True)


def _words(key: str, value: str) -> str:
    if value == 'nan':
        return '-'
    if key.endswith(('_mean', '_std', '_deg')) and value != '-':
        return f'{float(value):.2f}'
    return value

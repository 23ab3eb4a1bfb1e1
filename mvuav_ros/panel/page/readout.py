"""The chosen node's results: large figures with their trust, the pose in space, curves."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from nicegui import ui
from nicegui.elements.scene.scene_object3d import Object3D

from mvuav_ros.panel import sanitized
from mvuav_ros.panel.live_nodes import LiveNode
from mvuav_ros.panel.page import elements as el
from mvuav_ros.panel.page.context import Page
from mvuav_ros.processing.registry import PROCESSORS
from mvuav_ros.vision.rig import TANKER_747

Point = tuple[float, float, float]
_PORT, _STARBOARD, _WHITE = '#e02020', '#10b040', '#ffffff'
"""Lights: red left, green right, white in the middle."""
_BODY, _CAMERA, _ASPHALT = '#8a97a6', '#0b62b8', '#5a6068'
_AXES, _MAX_VIEW = 12.0, 25.0
_TANKER = (
    # Ends of fuselage, wings, stabilizers and fin of the tanker of the thesis, m, and radii.
    ((-36.0, 0.0, 0.0), (34.0, 0.0, 0.0), 3.2),
    ((4.0, 0.0, 0.0), (-12.0, 29.8, 1.0), 1.3),
    ((4.0, 0.0, 0.0), (-12.0, -29.8, 1.0), 1.3),
    ((-32.0, 0.0, 2.0), (-37.0, 11.0, 3.0), 0.8),
    ((-32.0, 0.0, 2.0), (-37.0, -11.0, 3.0), 0.8),
    ((-32.0, 0.0, 1.0), (-36.5, 0.0, 13.0), 0.8),
)
_RATES = {True: 20, False: 0.5}
"""Images of the scene per second, on the screen and off it, where a browser still draws them."""
_RUNWAY_LENGTH, _DEFAULT_WIDTH = 1500.0, 45.0
_NEEDS = 'a calibrated camera (camera_info), and names of four lights, or mode approach with a'
_COUNTS = {'rho_flags': 'rho flags', 'theta_flags': 'theta flags', 'combined_flags': 'combined'}
_MEANS = {
    'rho_mean': 'mean rho px',
    'rho_std': 'std',
    'theta_mean_deg': 'mean theta °',
    'theta_std_deg': 'std',
}


def make_readout() -> ui.element:
    """Large figures with the state of trust, which ``static/live.js`` fills.

    Returns the canvas of the node's result image, which stands beside them on a telephone.
    """
    with el.box('readout card', 'section').props('aria-label=Result'):
        with el.box('preview well').props('data-fresh=never'):
            canvas = el.box('image', 'canvas').props('role=img aria-label="Result"')
        with el.box('grow'):
            el.text('no results yet', 'trust').props('data-trust=stale')
            el.box('figures', 'dl')
    return canvas


class PoseScene:
    """The pose in space, to be turned with the mouse; ``static/live.js`` moves its bodies.

    One for a page, whatever node is looked at: a browser never gives up a scene that it has drawn.
    """

    def __init__(self) -> None:
        self._kind = ''
        with el.box('card pose'):
            self._title = el.text('Pose', tag='h2')
            viewer = ui.scene.perspective_camera(fov=40, near=1.0, far=4000.0)
            view = ui.scene(grid=(400, 40), background_color='#dfe6ee', camera=viewer)
            self._scene = view.classes('scene').props('role=img')
            self._why = el.text('', 'soft small no-pose')
        with self._scene as scene:
            with scene.group() as self._own:
                self._cone = _make_view(scene)
                scene.axes_helper(_AXES)
                for color, y in ((_PORT, 1.5), (_STARBOARD, -1.5)):
                    scene.sphere(0.6).material(color).move(0.0, y, 0.0)
            with scene.group() as self._tanker:
                scene.axes_helper(2 * _AXES)
                for start, end, radius in _TANKER:
                    _rod(scene, start, end, radius)
                for _, (x, y, z) in TANKER_747.markers:
                    color = _PORT if y > 0 else _STARBOARD if y < 0 else _WHITE
                    scene.sphere(2.0).material(color).move(x, y, z)
            with scene.group() as self._runway:
                scene.axes_helper(_AXES)
                self._strip = scene.box(_RUNWAY_LENGTH, 1.0, 0.1).material(_ASPHALT)
                self._strip.move(_RUNWAY_LENGTH / 2)
                for stroke in range(30, int(_RUNWAY_LENGTH), 60):
                    scene.box(30.0, 0.9, 0.12).material(_WHITE).move(stroke)
            # A body has a place in space once its pose is known; the page itself shows it then.
            self._tanker.visible(False)
            self._own.visible(False)

    def appear(self, visible: bool) -> None:
        """Draw what is on the screen only."""
        el.set_props(self._scene, fps=_RATES[visible])

    def show(self, node: LiveNode | None) -> None:
        """Show the bodies of this node's kind, and why there may be no pose."""
        is_silent = node and not node.alive
        why = 'the node does not answer' if is_silent else f'it needs {_NEEDS} runway_width'
        self._why.set_text(f'No pose: {why}.')
        if node is None or 'pose' not in PROCESSORS[node.kind].topics:
            return
        tracks = node.kind == 'marker_tracker'
        if node.kind != self._kind:
            self._kind = node.kind
            words = 'the tanker before the camera' if tracks else 'the camera before the runway'
            self._title.set_text(f'Pose: {words}')
            self._runway.visible(not tracks)
            if tracks:
                self._scene.move_camera(-60, 45, 35, 50, 0, 0, duration=0)
            else:
                self._scene.move_camera(-230, 75, 70, -30, 0, 8, duration=0)
            moved, still = (self._tanker.id, self._own.id) if tracks else (self._own.id, '-')
            objects = f'{moved} {still} {self._cone.id}'
            el.set_props(self._scene, data_objects=objects, aria_label=f'Pose: {words}, in space')
        width = node.values.get('runway_width')
        wide = width if isinstance(width, float) and 0 < width < 1e3 else _DEFAULT_WIDTH
        if not tracks and self._strip.sy != wide:
            self._strip.scale(1.0, wide, 1.0)


def _make_view(scene: ui.scene) -> Object3D:
    """What the camera sees, as a pyramid; a view of 1 to each side at a distance of 1."""
    corners = [(1.0, y, z) for y, z in ((1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0))]
    with scene.group() as cone:
        for corner, after in zip(corners, corners[1:] + corners[:1], strict=True):
            scene.line([0.0, 0.0, 0.0], list(corner)).material(_CAMERA)
            scene.line(list(corner), list(after)).material(_CAMERA)
    return cone.scale(_MAX_VIEW, 0.6 * _MAX_VIEW, 0.45 * _MAX_VIEW)


def _rod(scene: ui.scene, start: Point, end: Point, radius: float) -> None:
    """A cylinder between two points, which three.js makes along y."""
    along = np.subtract(end, start)
    length = float(np.linalg.norm(along))
    aside = np.cross(along / length, (0.6, 0.0, 0.8))
    aside /= np.linalg.norm(aside)
    turn = np.column_stack((aside, along / length, np.cross(aside, along / length)))
    rod = scene.cylinder(0.7 * radius, radius, length, 12).material(_BODY)
    rod.move(*np.add(start, end) / 2).rotate_R(turn.tolist())


class Results:
    """A node's tables and charts; curves come over the page's own WebSocket."""

    def __init__(self, page: Page, node: LiveNode) -> None:
        self._page, self._node = page, node
        self._lines: ui.table | None = None
        if 'reset_statistics' in PROCESSORS[node.kind].triggers:
            with el.box('card'):
                with el.box('line titled'):
                    el.text('Statistics since the last reset', 'title grow', tag='h2')
                    el.button('Reset', self._reset, 'restart_alt')
                heads = ('line', 'frames', *_COUNTS.values(), *_MEANS.values())
                self._lines = el.sheet('Statistics of the lines', heads)
        with el.box('charts'):
            for name, chart in PROCESSORS[node.kind].panel.charts.items():
                with el.box('card'):
                    made = ui.echart(el.axes(chart.title, chart.unit)).classes('chart')
                    # Until the first value there is nothing that the chart would say of itself.
                    words = f'Curve of {chart.title}'
                    el.set_props(made, aria_label=words, data_curves=name, data_node=node.name)
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
            el.notify(reason, bad=True)


def _statistics_rows(said: Mapping[str, Mapping[str, str]]) -> list[list[str]]:
    """All lines, and each; numbered from 1, as in the images."""

    def row(name: str, values: Mapping[str, str], frames: str) -> list[str]:
        counts = [sanitized.fixed(values.get(key), 0) for key in (frames, *_COUNTS)]
        means = [sanitized.fixed(values[key], 2) if key in values else '' for key in _MEANS]
        return [name, *counts, *means]

    lines = [row(name, said[name], 'found') for name in said if name.startswith('line ')]
    return [row('all lines', said.get('runway', {}), 'frames'), *lines]

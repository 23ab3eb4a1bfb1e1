"""What the parts of one page share."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Awaitable, Callable, Mapping, MutableMapping, Sequence
from pathlib import Path
from typing import Any

from nicegui import Event

from mvuav_ros.panel.controls import EVERY_NODE
from mvuav_ros.panel.image_feed import ImageFeed
from mvuav_ros.panel.live_nodes import LiveNode, LiveSystem
from mvuav_ros.panel.node_recorder import NodeRecorder
from mvuav_ros.panel.ros_thread import RosThread
from mvuav_ros.panel.runs import Runner, RunStore
from mvuav_ros.panel.sets import SetStore
from mvuav_ros.parameters.declaration import Value
from mvuav_ros.recordings.layout import shipped_folder

_ONE_MOVEMENT = 1.0
"""Seconds; quicker changes of one parameter are one movement of a hand."""
_MAX_CHANGES = 200

Values = Mapping[str, Value]
Load = Callable[[Values, str], Awaitable[None]]
"""Gives the selected node the values of a set or run, which has this name."""


class Services:
    """Of the whole process: running nodes and their images, saved sets, runs and recordings.

    What is saved goes below ``folder``, runs that are not kept below ``scratch``; ``bags`` are
    recordings and folders of them, or the sample bags. ``sets_changed`` says that a set was saved,
    taken in or deleted, on whatever page; ``runs_changed`` the same of a run or recording.
    ``recorders`` are the last of each node, under way or over; ``runner`` has the run under way,
    of which ``run_progressed`` says that it went on.
    """

    def __init__(
        self, ros: RosThread, folder: Path, bags: Sequence[Path] | None, scratch: Path
    ) -> None:
        shipped = shipped_folder('bags')
        self.ros, self.scratch = ros, scratch
        self.system, self.feed = LiveSystem(ros), ImageFeed(ros)
        self.sets = SetStore(folder / 'sets', shipped_folder('config'))
        self.runs = RunStore(folder / 'runs')
        self.recordings = folder / 'recordings'
        self.recorders: dict[str, NodeRecorder] = {}
        self.bags = bags or ([shipped] if shipped else [])
        self.sets_changed: Event[()] = Event()
        self.runs_changed: Event[()] = Event()
        self.run_progressed: Event[()] = Event()
        self.runner = Runner(self.runs, self.run_progressed.emit)

    def end(self) -> None:
        """End what is under way, so that all of it is in its files."""
        for recorder in self.recorders.values():
            recorder.stop()


class History:
    """A user's changes of one node: the values before and after each, ``done`` and ``undone``."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._changed_at = clock, 0.0
        self.done: list[tuple[Values, Values]] = []
        self.undone: list[tuple[Values, Values]] = []

    def record(self, before: Values, after: Values) -> None:
        """Keep a change that the node has taken."""
        if dict(before) == dict(after):
            return
        quick = self._clock() - self._changed_at < _ONE_MOVEMENT
        if quick and not self.undone and self.done and self.done[-1][1].keys() == after.keys():
            before = self.done.pop()[0]
        # There and back again is no step, and no movement that goes on.
        is_step = dict(before) != dict(after)
        self.done += [(before, after)] if is_step else []
        del self.done[:-_MAX_CHANGES]
        self.undone.clear()
        self._changed_at = self._clock() if is_step else 0.0

    def step(self, *, back: bool) -> Values:
        """The values that take back the last change, or do it again; none where there is none."""
        steps, others = (self.done, self.undone) if back else (self.undone, self.done)
        if not steps:
            return {}
        others.append(steps.pop())
        before, after = others[-1]
        return before if back else after


class Page:
    """Of one browser tab: which node is looked at, and what is to survive a reload.

    That is ``kept``; ``sets``, ``edits`` (values that a node has not taken yet) and ``recordings``
    are by node. ``on_select`` is called after another node was selected.
    """

    def __init__(
        self, services: Services, kept: MutableMapping[str, Any], on_select: Callable[[], object]
    ) -> None:
        self.services, self.kept, self._on_select = services, kept, on_select
        self.histories: defaultdict[str, History] = defaultdict(History)
        fresh: dict[str, Any] = {'node': '', 'part': 'images', 'at_once': True, 'ticks': []}
        fresh |= {'folded': ['Node', EVERY_NODE], 'sets': {}, 'edits': {}, 'recordings': {}}
        for name, value in fresh.items():
            kept.setdefault(name, value)

    @property
    def selected(self) -> str:
        """Name of the node that parameters, results and runs are about."""
        return str(self.kept['node'])

    @property
    def node(self) -> LiveNode | None:
        """The selected node."""
        return self.services.system.nodes.get(self.selected)

    def select(self, name: str) -> None:
        """Look at another node."""
        if name != self.selected:
            self.kept['node'] = name
            self._on_select()

    @property
    def chosen_set(self) -> str:
        """The set that the node's values are held against; may be empty."""
        return str(self.kept['sets'].get(self.selected, ''))

    @chosen_set.setter
    def chosen_set(self, name: str) -> None:
        self.kept['sets'][self.selected] = name

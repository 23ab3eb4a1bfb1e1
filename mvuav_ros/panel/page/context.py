"""What the parts of one page share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mvuav_ros.panel.images import ImageFeed
from mvuav_ros.panel.live_system import LiveNode, LiveSystem
from mvuav_ros.panel.runs import RunStore
from mvuav_ros.panel.sets import SetStore
from mvuav_ros.parameters.declaration import Value


@dataclass(frozen=True)
class Services:
    """Of the whole process.

    Attributes:
        system: the running nodes.
        feed: their images.
        sets: named parameters.
        runs: saved runs.
        bags: folders and files with recordings.
        scratch: folder for runs that are not kept.
    """

    system: LiveSystem
    feed: ImageFeed
    sets: SetStore
    runs: RunStore
    bags: tuple[Path, ...]
    scratch: Path


@dataclass
class Page:
    """Of one page: which node is looked at, and with which set it is compared."""

    services: Services
    selected: str = ''
    chosen_set: str = ''
    on_select: list[Callable[[], Any]] = field(default_factory=list)

    @property
    def node(self) -> LiveNode | None:
        """The node that parameters, results and runs are about."""
        return self.services.system.nodes.get(self.selected)

    def select(self, name: str) -> None:
        """Look at another node."""
        if name != self.selected:
            self.selected, self.chosen_set = name, ''
            for changed in self.on_select:
                changed()

    def own_values(self) -> dict[str, Value]:
        """The selected node's values, without what every ROS node has."""
        node = self.node
        if node is None:
            return {}
        return {
            control.name: node.values[control.name]
            for control in node.controls
            if not control.foreign and node.values.get(control.name) is not None
        }

"""Names over time: which are published, and how probable it is that one is wrong."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from doc_pictures.style import BLUE, GRAY, GREEN, INK, ORANGE, save
from mvuav_ros import track
from mvuav_ros.vision.markers.marker_results import MarkerState

_FLIGHT = (
    'sim:tanker?motion=erratic&frames=240&seed=4&glares=3'
    '&failures=left_wing@1.5-2.5, rudder@2-3.5, right_wing@5-6, left_stabilizer@5-5.6'
)
_COLORS = {
    MarkerState.DETECTED: (GREEN, 'published'),
    MarkerState.PREDICTED: (ORANGE, 'predicted'),
    MarkerState.LOST: (GRAY, 'withheld or lost'),
}


def name_confidence(path: Path) -> None:
    """A row for each marker of a flight whose lights go out and come back among glares."""
    frames = list(track(_FLIGHT))
    times = np.array([frame.stamp_ns for frame in frames]) * 1e-9
    times -= times[0]
    names = list(frames[0].markers)
    figure, axes = plt.subplots(len(names), 1, figsize=(8.6, 6.4), sharex=True)
    for axis, name in zip(axes, names, strict=True):
        markers = [frame.markers[name] for frame in frames]
        wrong = [1.0 - marker.confidence for marker in markers]
        axis.semilogy(times, wrong, color=BLUE, lw=1.4)
        for state, (color, label) in _COLORS.items():
            here = np.array([marker.state is state for marker in markers])
            axis.fill_between(
                times, 0, 1, where=here, step='mid', color=color, alpha=0.25, lw=0,
                label=label, transform=axis.get_xaxis_transform(),
            )  # fmt: skip
        axis.set_ylim(5e-5, 0.3)
        axis.set_ylabel(name.replace('_', '\n'), color=INK, fontsize=9, rotation=0, ha='right')
        axis.grid(alpha=0.3)
    axes[0].set_title('Probability that a name is wrong, 1 - confidence', loc='left', fontsize=10)
    axes[0].legend(loc='upper right', ncols=3, fontsize=8)
    axes[-1].set_xlabel('time [s]', color=INK)
    save(figure, path)

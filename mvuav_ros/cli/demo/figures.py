"""The demo's three figures, from the bag that it recorded and the truth of the sample bags."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from mvuav_ros.messages.definitions import decode_message
from mvuav_ros.messages.images import decode_image
from mvuav_ros.messages.sensors import stamp_ns_of
from mvuav_ros.offline.evaluation.bag_report import roll_figure
from mvuav_ros.offline.evaluation.evaluation_run import EvaluationRun, read_bag
from mvuav_ros.offline.evaluation.metrics import roll_errors
from mvuav_ros.recordings.account import SourceError
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.remote import write_whole
from mvuav_ros.vision.markers.marker_results import TANKER_NAMES, MarkerState

_GREEN, _YELLOW = '#50e66e', '#ffd800'
_SHADOW = [withStroke(linewidth=3, foreground='black')]


def _read(bag: Path, topic: str) -> dict[int, Any]:
    """One topic's messages by their stamps (ns)."""
    with open_recording(bag) as recording:
        messages = [decode_message(each.type, each.data) for each in recording.messages({topic})]
    return {stamp_ns_of(message.header): message for message in messages}


def save_tanker(run: EvaluationRun, bag: Path, target: Path) -> Path:
    """Two frames with the names of the lights: all in view, and one of them off."""
    markers, rolls = run.results.markers, run.results.rpy
    images = _read(bag, '/tanker/image_raw')
    poses = _read(bag, '/marker_tracker/pose')
    stamps = sorted(images.keys() & markers.keys() & rolls.keys() & poses.keys())
    off = [stamp for stamp in stamps if (markers[stamp]['state'] == MarkerState.PREDICTED).any()]
    shown = [stamps[len(stamps) // 3], *off[len(off) // 2 :][:1]]
    figure, axes = _side_by_side(len(shown))
    titles = ('All five lights found and named', 'One light is off: its place is predicted')
    for axis, stamp, title in zip(axes.flat, shown, titles, strict=False):
        _show(axis, images[stamp])
        _draw_names(axis, markers[stamp])
        distance = poses[stamp].pose.pose.position.z
        roll = np.degrees(rolls[stamp])
        down = 'right' if roll > 0 else 'left'
        axis.set_title(f'{title}\nroll {roll:+.1f}° ({down} wing down), {distance:.0f} m away')
    figure.savefig(target, dpi=100)
    return target


def _draw_names(axis: Axes, rows: NDArray[Any]) -> None:
    middle = np.array([rows['x'].mean(), rows['y'].mean()])
    for row in rows:
        predicted = row['state'] == MarkerState.PREDICTED
        color, word = (_YELLOW, ' (predicted)') if predicted else (_GREEN, '')
        place = np.array([row['x'], row['y']])
        away = (place - middle) / max(1.0, float(np.hypot(*(place - middle))))
        axis.plot(*place, 'o', ms=14, mfc='none', mec=color, mew=2)
        name = TANKER_NAMES[row['label']].replace('_', ' ') + word
        x, y = place + away * 38
        style: Any = {'ha': 'center', 'va': 'center', 'path_effects': _SHADOW}
        axis.text(x, y, name, color=color, clip_on=True, **style)


def save_roll(run: EvaluationRun, sample: Path, target: Path) -> Path:
    """Roll against time with the truth beside it, and the error below."""
    errors = roll_errors(replace(run, truth=read_bag(sample).truth))
    if errors is None:
        raise SourceError(f'no roll was measured in a frame of {sample}')
    write_whole(target, roll_figure(errors).png)
    return target


def save_runway(bag: Path, sample: Path, target: Path) -> Path:
    """One frame as two nodes draw it: mode approach with its guidance, and the thesis's scheme."""
    approach = _read(bag, '/runway_detector/debug/overlay')
    poses = _read(bag, '/runway_detector/pose')
    thesis = _read(bag, '/runway_thesis/debug/overlay')
    truth = _read(sample, '/truth/pose')
    stamps = sorted(approach.keys() & poses.keys() & thesis.keys() & truth.keys())
    stamp = stamps[len(stamps) // 3]
    here, there = poses[stamp].pose.pose.position, truth[stamp].pose.position
    side = 'left' if here.y > 0 else 'right'
    figure, axes = _side_by_side(2)
    left, right = axes.flat
    _show(left, approach[stamp])
    left.set_title(
        'Mode approach finds the runway by itself\n'
        f'{abs(here.y):.1f} m {side} of the centreline, {here.z:.1f} m high '
        f'(truth: {abs(there.y):.1f} m, {there.z:.1f} m)'
    )
    _show(right, thesis[stamp])
    right.set_title(
        "The thesis's scheme draws the strongest lines\n"
        'green agrees with the last frame; red has jumped, and kept its old place'
    )
    figure.savefig(target, dpi=100)
    return target


def _side_by_side(count: int) -> tuple[Figure, Any]:
    figure = Figure(figsize=(6.5 * count, 5.6), layout='constrained')
    return figure, figure.subplots(1, count, squeeze=False)


def _show(axis: Axes, message: Any) -> None:
    image = decode_image(message).bgr()
    axis.imshow(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), interpolation='bilinear')
    axis.set(xticks=[], yticks=[], xlim=(0, image.shape[1]), ylim=(image.shape[0], 0))

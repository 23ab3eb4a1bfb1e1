"""The coordinate frames, drawn with the package's own conversions."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from doc_pictures.style import BLUE, GRAY, GREEN, INK, ORANGE, RED, save
from mvuav_ros import Image, MarkerTracker
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.sources.opening import make_flight
from mvuav_ros.vision.frames import from_rpy
from mvuav_ros.vision.runway.normal_form import NormalForm, segment_ends


def image_frame(path: Path) -> None:
    """Pixels, and the normal form of a line with the ends that the package computes."""
    figure, axis = plt.subplots(figsize=(7.4, 5.2))
    width, height = 320, 240
    axis.set(xlim=(-45, width + 15), ylim=(height + 22, -40))
    axis.set_aspect('equal')
    axis.axis('off')
    axis.add_patch(plt.Rectangle((-0.5, -0.5), width, height, fill=False, ec=INK, lw=1.5))
    _arrow(axis, (0, 0), (70, 0), RED)
    _arrow(axis, (0, 0), (0, 70), GREEN)
    axis.text(74, -7, 'x', color=RED, fontsize=13)
    axis.text(-14, 74, 'y', color=GREEN, fontsize=13)
    axis.plot(0, 0, 'o', color=INK)
    axis.text(-42, -14, '(0, 0): the centre of\nthe top-left pixel', fontsize=9)
    line = NormalForm(150.0, math.radians(35))
    ends = segment_ends(line, width, height)
    x1, y1, x2, y2 = ends
    axis.plot([x1, x2], [y1, y2], color=BLUE, lw=2.5)
    axis.text(x2 + 22, y2 - 14, 'a line', color=BLUE)
    foot = (line.rho * math.cos(line.theta), line.rho * math.sin(line.theta))
    axis.plot([0, foot[0]], [0, foot[1]], color=ORANGE, lw=1.8, ls='--')
    axis.text(foot[0] * 0.62 + 4, foot[1] * 0.62 - 10, 'ρ', color=ORANGE, fontsize=15)
    angles = np.linspace(0, line.theta, 20)
    axis.plot(48 * np.cos(angles), 48 * np.sin(angles), color=ORANGE)
    axis.text(54, 22, 'θ', color=ORANGE, fontsize=15)
    axis.text(120, 205, 'x cos θ + y sin θ = ρ', fontsize=13, color=INK)
    axis.text(
        120, 222, f'here ρ = {line.rho:.0f} px, θ = {math.degrees(line.theta):.0f}°', fontsize=9
    )
    for x, y, name in ((x1, y1, '(x, y)'), (x2, y2, '(x2, y2)')):
        axis.plot(x, y, 's', color=BLUE, ms=6)
        axis.text(x - 8, y + (-6 if y < 120 else 16), name, fontsize=9, color=BLUE, ha='center')
    axis.text(width / 2, height + 16, 'image: 320 x 240 px', fontsize=9, color=GRAY, ha='center')
    save(figure, path)


def body_frames(path: Path) -> None:
    """Optical axes of the camera beside the axes of a body, in space."""
    figure = plt.figure(figsize=(10, 4.4))
    titles = ('camera, optical frame', 'body (tanker, drone, aircraft)')
    # Columns are x, y, z in a world with x ahead, y left, z up.
    optical = np.array([(0, 0, 1), (-1, 0, 0), (0, -1, 0)], float)
    names = (
        ('x right', 'y down', 'z ahead'),
        ('x forward', 'y left', 'z up'),
    )
    for number, (title, axes) in enumerate(zip(titles, (optical, np.eye(3)), strict=True)):
        axis = figure.add_subplot(1, 2, number + 1, projection='3d')
        axis.view_init(elev=22, azim=-150)
        axis.set(xlim=(-0.6, 1.1), ylim=(-1.0, 1.0), zlim=(-1.0, 1.0))
        axis.set_axis_off()
        axis.set_box_aspect((1.7, 2.0, 2.0), zoom=1.3)
        for column, (name, color) in enumerate(zip(names[number], (RED, GREEN, BLUE), strict=True)):
            end = axes[:, column]
            axis.quiver(0, 0, 0, *end, color=color, lw=2.5, arrow_length_ratio=0.12)
            axis.text(*(end * 1.22), name, color=color, fontsize=11, ha='center')
        _outline(axis, number == 0)
        axis.set_title(title, fontsize=12)
    figure.subplots_adjust(wspace=0.0)
    save(figure, path)


def _outline(axis: Axes, camera: bool) -> None:
    if camera:
        corners = [
            (0.75, y, z) for y, z in ((0.45, 0.34), (-0.45, 0.34), (-0.45, -0.34), (0.45, -0.34))
        ]
        for corner in corners:
            axis.plot(*zip((0, 0, 0), corner, strict=True), color=GRAY, lw=1)
        axis.plot(*zip(*corners, corners[0], strict=True), color=GRAY, lw=1.5)
        return
    for part in (
        ((0.9, 0, 0), (-0.6, 0, 0)),
        ((0.1, 0, 0), (-0.2, 0.8, 0.03)),
        ((0.1, 0, 0), (-0.2, -0.8, 0.03)),
        ((-0.5, 0, 0), (-0.6, 0.3, 0.05)),
        ((-0.5, 0, 0), (-0.6, -0.3, 0.05)),
        ((-0.5, 0, 0), (-0.6, 0, 0.35)),
    ):
        axis.plot(*zip(*part, strict=True), color=GRAY, lw=3)


def runway_frame(path: Path) -> None:
    """Seen from above and from the side: offset, height, heading error."""
    figure, (above, side) = plt.subplots(1, 2, figsize=(11, 4.4))
    for axis in (above, side):
        axis.set_aspect('equal')
        axis.axis('off')
    above.add_patch(plt.Rectangle((0, -1.2), 9, 2.4, fc='#dddddd', ec=INK))
    above.plot([0, 9], [0, 0], color='white', lw=2, ls=(0, (6, 5)))
    above.plot([-7, 9], [0, 0], color=GRAY, lw=0.8, ls=':')
    _arrow(above, (0, 0), (3, 0), RED)
    _arrow(above, (0, 0), (0, 2.4), GREEN)
    above.text(3.1, 0.25, 'x', color=RED, fontsize=13)
    above.text(0.2, 2.3, 'y', color=GREEN, fontsize=13)
    place, yaw = np.array((-6.0, 1.9)), math.radians(-14)
    nose = place + 2.4 * np.array((math.cos(yaw), math.sin(yaw)))
    above.plot(*place, 'o', color=BLUE, ms=8)
    _arrow(above, tuple(place), tuple(nose), BLUE)
    above.text(place[0] - 0.3, place[1] + 0.5, 'camera', color=BLUE, ha='right')
    above.plot([place[0], place[0]], [0, place[1]], color=ORANGE, lw=1.5)
    above.text(
        place[0] - 0.25,
        0.85,
        'lateral\noffset\ny > 0',
        color=ORANGE,
        ha='right',
        va='center',
        fontsize=10,
    )
    above.plot([place[0], place[0] + 2.6], [place[1], place[1]], color=GRAY, lw=0.8, ls=':')
    above.text(place[0] + 0.3, place[1] + 0.3, 'heading error:\nyaw < 0, nose right', fontsize=9)
    above.annotate(
        '', xy=(0, -1.9), xytext=(place[0], -1.9), arrowprops={'arrowstyle': '<->', 'color': INK}
    )
    above.text(place[0] / 2, -2.6, 'x < 0 before the near end', ha='center', fontsize=9)
    above.set(xlim=(-8.6, 9.4), ylim=(-3.2, 3.6))
    above.set_title('from above', fontsize=12)
    side.plot([-7.5, 9], [0, 0], color=GRAY, lw=0.8)
    side.plot([0, 9], [0, 0], color=INK, lw=5, solid_capstyle='butt')
    _arrow(side, (0, 0), (3, 0), RED)
    _arrow(side, (0, 0), (0, 2.4), BLUE)
    side.text(3.1, 0.3, 'x', color=RED, fontsize=13)
    side.text(0.2, 2.3, 'z', color=BLUE, fontsize=13)
    camera, pitch = np.array((-6.0, 3.0)), math.radians(-12)
    nose = camera + 2.4 * np.array((math.cos(pitch), math.sin(pitch)))
    side.plot(*camera, 'o', color=BLUE, ms=8)
    _arrow(side, tuple(camera), tuple(nose), BLUE)
    side.plot([camera[0], camera[0] + 2.6], [camera[1], camera[1]], color=GRAY, lw=0.8, ls=':')
    side.text(nose[0] + 0.2, nose[1], 'pitch > 0:\nnose down', fontsize=9, va='center')
    side.plot([camera[0], camera[0]], [0, camera[1]], color=ORANGE, lw=1.5)
    side.text(camera[0] - 0.25, 1.4, 'height z', color=ORANGE, ha='right', va='center', fontsize=10)
    side.text(
        4.5, -0.9, 'runway; origin at the near end, on the centreline', ha='center', fontsize=9
    )
    side.set(xlim=(-8.6, 9.4), ylim=(-1.6, 4.2))
    side.set_title('from the side', fontsize=12)
    figure.tight_layout()
    save(figure, path)


def roll_sign(path: Path) -> None:
    """Two simulated tankers with the roll that the tracker reports for each."""
    figure, axes = plt.subplots(1, 2, figsize=(10, 4.2))
    for axis, roll in zip(axes, (-20.0, 20.0), strict=True):
        given = {
            'frames': 1,
            'motion': 'still',
            'roll_deg': roll,
            'background': 'sky',
            'noise': 0.0,
        }
        frame = next(iter(make_flight('tanker', given)))
        tracker = MarkerTracker(MarkerTrackerParameters(mode='detect'))
        result = tracker.process(Image(frame.image.pixels, frame.image.encoding), 0)
        shown = cv2.cvtColor(frame.image.bgr(), cv2.COLOR_BGR2RGB)
        axis.imshow(shown[90:390])
        axis.axis('off')
        degrees = math.degrees(result.roll)
        wing = 'right wing down' if degrees > 0 else 'left wing down'
        axis.set_title(f'roll {degrees:+.1f}°: {wing}', fontsize=12)
        for name, marker in zip(tracker.rig.names, result.markers, strict=True):
            if 'wing' in name:
                color = '#ff6060' if 'left' in name else '#40ff60'
                axis.plot(marker.x, marker.y - 90, 'o', ms=13, mfc='none', mec=color, mew=2)
                axis.text(marker.x, marker.y - 90 + 32, name, color=color, ha='center', fontsize=10)
    # The sign is that of the package's own rotation about x, which is forward.
    assert from_rpy(0.1, 0.0, 0.0)[2, 1] > 0
    figure.tight_layout(pad=0.5)
    save(figure, path)


def _arrow(axis: Axes, start: tuple[float, float], end: tuple[float, float], color: str) -> None:
    arrow = {'arrowstyle': '-|>', 'color': color, 'lw': 2.2, 'shrinkA': 0, 'shrinkB': 0}
    axis.annotate('', xy=end, xytext=start, arrowprops=arrow)

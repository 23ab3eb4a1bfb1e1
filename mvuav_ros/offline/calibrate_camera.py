"""A camera calibrated from a recording of a board: its views, its file and its report."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import compress, product

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.messages.images import BadFrame
from mvuav_ros.offline.report import Figure, Report, Section, Table
from mvuav_ros.offline.report_figures import COLORS, drawing, residual_figure
from mvuav_ros.sources.source import FrameSource, SourceError, nothing_to_read
from mvuav_ros.vision.board import Board, BoardView, different_views, in_eight_bits, sharpness
from mvuav_ros.vision.camera import CalibrationError
from mvuav_ros.vision.camera_calibration import MIN_VIEWS, CameraCalibration, calibrate_camera
from mvuav_ros.vision.image import ImageError
from mvuav_ros.vision.point_operations import Pixels

MAX_SEARCHES = 200
"""Images of a recording in which the board is searched: of each stretch of time the sharpest."""
APART = 0.03
"""Part of the image's diagonal by which the outer corners of two views differ that count as two."""
_NOT_THE_SAME = 0.004
"""Of two that are both used, as the corners' noise is a new one in each image."""
_THUMBNAIL = 320  # px
_SHOWN = 9  # Pictures of views in the report
_CELLS = 8, 6  # Into which the image is divided for its coverage
_COLUMNS = {'left': slice(2), '': slice(2, 6), 'right': slice(6, 8)}
_ROWS = {'top': slice(2), '': slice(2, 4), 'bottom': slice(4, 6)}
_NEAR = 0.8
"""Part of the image corners' distance from the axis, below which the corners' is worth a word."""


@dataclass
class BoardSearch:
    """What a recording shows of a board: every view, its time and its image.

    ``stamps`` are s since the first frame, ``thumbnails`` are for people. So many frames were
    read, and so many of them searched.
    """

    size: tuple[int, int] = (0, 0)
    views: list[BoardView] = field(default_factory=list)
    stamps: list[float] = field(default_factory=list)
    thumbnails: list[Pixels] = field(default_factory=list)
    frames: int = 0
    searched: int = 0

    def different(self, most: int, apart: float = APART) -> list[int]:
        """The views that differ from each other, as numbers; those that differ most first."""
        return different_views(self.views, self.size, most, apart)


def search_board(
    source: FrameSource,
    board: Board,
    most: int,
    seconds: float,
    advance: Callable[[], object] = lambda: None,
) -> BoardSearch:
    """Look for a board in a recording, or in a camera's images.

    A camera is left when it has shown the ``most`` different views, or after some seconds.
    ``advance`` is called for each frame.

    Raises:
        SourceError: it has no frames, frames of several sizes, or cannot be read.
    """
    search, start = BoardSearch(), time.monotonic()
    for stamp, gray in _sharpest(source, search, advance):
        search.searched += 1
        view = board.find(gray)
        if view is not None:
            search.views.append(view)
            search.stamps.append(stamp)
            scale = _THUMBNAIL / gray.shape[1]
            small = cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            search.thumbnails.append(in_eight_bits(small))
        if source.live and (
            len(search.different(most)) >= most or time.monotonic() > start + seconds
        ):
            break
    if not search.frames:
        raise nothing_to_read(source)
    return search


def _sharpest(
    source: FrameSource, search: BoardSearch, advance: Callable[[], object]
) -> Iterator[tuple[float, Pixels]]:
    """Of each stretch of frames the sharpest one: its time (s) and its grey image."""
    best: tuple[float, float, Pixels] | None = None
    first_ns, inside = None, 0
    for number, frame in enumerate(source.frames(), 1):
        advance()
        try:
            if isinstance(frame, BadFrame):
                raise ImageError(frame.reason)
            gray = frame.image.gray()
        except ImageError as error:
            source.account.leave_out(frame.stamp_ns, str(error))
            continue
        first_ns = frame.stamp_ns if first_ns is None else first_ns
        size = frame.image.width, frame.image.height
        if search.frames and size != search.size:
            raise SourceError(
                f'{source.name}: image {number} is {size[0]} x {size[1]} px, those before it '
                f'{search.size[0]} x {search.size[1]} px: a calibration is for one size'
            )
        search.size, search.frames, inside = size, search.frames + 1, inside + 1
        value = sharpness(gray)
        if best is None or value > best[0]:
            best = value, (frame.stamp_ns - first_ns) * 1e-9, gray
        # Of a length that nobody knows the first stretches are short and later ones longer.
        known = source.count
        if inside >= (-(-known // MAX_SEARCHES) if known else 2 ** (search.searched // 60)):
            yield best[1:]
            best, inside = None, 0
    if best is not None:
        yield best[1:]


def calibrate_from(
    search: BoardSearch, board: Board, model: str, most: int
) -> tuple[list[int], CameraCalibration]:
    """The numbers of the views chosen, and the camera.

    Raises:
        CalibrationError: the views are too few or do not determine the camera.
    """
    found, looked = len(search.views), f'{search.searched} images looked at of {search.frames}'
    if not found:
        whole = ', and the whole board must be in view'
        raise CalibrationError(
            f'no board of {board.columns}x{board.rows} inner corners in {looked}: --board counts '
            'the corners where four squares meet'
            f'{"; --charuco names its dictionary" if board.dictionary else whole}'
        )
    chosen = search.different(most)
    if len(chosen) < MIN_VIEWS:
        raise CalibrationError(
            f'a board of {board.columns}x{board.rows} inner corners is seen in {found} of '
            f'{looked}, different views: {len(chosen)}. {MIN_VIEWS} are needed, and 20 to 40 are '
            'good: move the board over the whole image, and tilt it; and see that it has no more '
            'corners than --board says'
        )
    chosen = search.different(most, _NOT_THE_SAME)
    return chosen, calibrate_camera([search.views[i] for i in chosen], search.size, model)


def extent(views: Sequence[BoardView], found: CameraCalibration) -> str:
    """Say where the views in use show corners, and where none does, so that nothing was measured.

    In parts of the image, which count in cells of an eighth by a sixth of it, and in degrees off
    the camera's axis.
    """
    camera = found.camera
    pixels = np.concatenate([view.pixels for view in compress(views, found.used)])
    size, cells = np.array((camera.width, camera.height)), np.array(_CELLS)
    seen = np.zeros(_CELLS, np.bool_)
    seen[*np.clip((pixels / size * cells).astype(int), 0, cells - 1).T] = True
    corners = np.array(list(product(*([-0.5, side - 0.5] for side in size))))
    reach, whole = (
        float(np.degrees(np.arctan(np.linalg.norm(camera.undistort(places), axis=1))).max())
        for places in (pixels, corners)
    )
    said = f'corners in {100 * seen.mean():.0f} % of the image, up to {reach:.0f} of {whole:.0f} '
    said += 'degrees off the axis'
    parts = product(_ROWS.items(), _COLUMNS.items())
    empty = [f'{y} {x}'.strip() or 'middle' for (y, j), (x, i) in parts if not seen[i, j].any()]
    if empty:
        said += f', but none {", ".join(empty)}'
    # Not by the angles, which outside of what was measured are no better than the lens.
    middle = camera.matrix[:2, 2]
    near, far = (np.linalg.norm(places - middle, axis=1).max() for places in (pixels, corners))
    if empty or near < _NEAR * far:
        said += ': outside the lens is extrapolated, and may be wrong by many px; show the board '
        said += 'there'
    return said


def describe(found: CameraCalibration) -> Iterator[tuple[str, float, float, str]]:
    """Name, value, standard deviation and unit of each parameter that was fitted."""
    k, d = found.camera.k, found.camera.d
    names = {5: 'k1 k2 p1 p2 k3', 8: 'k1 k2 p1 p2 k3 k4 k5 k6'}.get(len(d), 'k1 k2 k3 k4').split()
    values = (k[0], k[4], k[2], k[5], *d)
    units = ('px',) * 4 + ('',) * len(d)
    rows = zip(('fx', 'fy', 'cx', 'cy', *names), values, found.deviations, units, strict=True)
    return (row for row in rows if row[2])


def report_of(
    name: str, board: Board, search: BoardSearch, chosen: Sequence[int], found: CameraCalibration
) -> Report:
    """The page: the camera, the views and what they leave unexplained."""
    views = [search.views[i] for i in chosen]
    tilts = np.degrees(found.tilts)
    rms = [float(np.sqrt(np.mean(each**2))) for each in found.residuals]
    parameters = Table.of(
        'camera',
        'Camera',
        'parameter | value .6 | standard deviation .6 | unit',
        describe(found),
        'Standard deviations are of the noise of the corners alone: noise² (JᵀJ)⁻¹.',
    )
    models = Table.of(
        'models',
        'Models, on views that were kept back',
        'model | residual [px] .4',
        list(found.kept_back.items()),
        'The simplest model is taken that no longer one beats by more than 1 %.',
    )
    table = Table.of(
        'views',
        'Views',
        'view | time [s] .2 | corners | tilt [deg] .1 | residual [px] | used',
        [
            (number, search.stamps[i], len(view.points), float(tilt), error, 'yes' if use else 'no')
            for number, (i, view, tilt, error, use) in enumerate(
                zip(chosen, views, tilts, rms, found.used, strict=True), 1
            )
        ],
        'A view that is not used has residuals far above the others: blurred, or a wrong corner.',
    )
    kind = f'ChArUco {board.dictionary}' if board.dictionary else 'checkerboard'
    return Report(
        f'Calibration of {name}',
        (
            f'{found.camera.distortion_model}, from {int(found.used.sum())} views; residual '
            f'{found.rms:.3f} px rms per axis; {extent(views, found)}.',
        ),
        {
            'source': name,
            'board': f'{kind}, {board.columns}x{board.rows} inner corners, {board.square:g} m',
            'frames': search.frames,
            'searched': search.searched,
            'board found': len(search.views),
        },
        (
            Section('Camera', (), (parameters, models) if found.kept_back else (parameters,)),
            Section('Coverage and residuals', (), (_coverage_figure(views, search.size, found),)),
            Section('Views', (), (_pictures(search, chosen, found.used), table)),
        ),
    )


def _coverage_figure(
    views: Sequence[BoardView], size: tuple[int, int], found: CameraCalibration
) -> Figure:
    return residual_figure(
        'Where corners were seen, and their residuals',
        size,
        found.rms,
        [
            (view.pixels, residual, COLORS[0] if use else COLORS[1], '')
            for view, residual, use in zip(views, found.residuals, found.used, strict=True)
        ],
        'corners over the image, each with an arrow',
        'a lens of another model or a bent board. Where no corner was, the lens is extrapolated. '
        'Orange: views left out.',
    )


def _pictures(search: BoardSearch, chosen: Sequence[int], used: NDArray[np.bool_]) -> Figure:
    order = [number for number in range(len(chosen)) if not used[number]][:3]
    order += [number for number in range(len(chosen)) if used[number]][: _SHOWN - len(order)]
    rows = -(-len(order) // 3)
    with drawing(9.6, 3.2 * rows * search.size[1] / search.size[0] + 0.25 * rows) as canvas:
        grid = canvas.figure.subplots(rows, 3, squeeze=False)
        for axes in grid.flat:
            axes.axis('off')
        for axes, number in zip(grid.flat, order, strict=False):
            image = search.thumbnails[chosen[number]]
            scale = image.shape[1] / search.size[0]
            places = (search.views[chosen[number]].pixels + 0.5) * scale - 0.5
            axes.imshow(image, cmap='gray', vmin=0, vmax=255)
            axes.plot(*places.T, '.', ms=2.0, color=COLORS[0] if used[number] else COLORS[1])
            axes.set_title(f'view {number + 1}' + ('' if used[number] else ', left out'))
    return canvas.as_figure('pictures', 'Some views', 'images of the board with its corners')

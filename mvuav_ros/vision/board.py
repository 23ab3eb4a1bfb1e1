"""Calibration boards: found in images, and the views of them that differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.bundle_adjustment import farthest_first
from mvuav_ros.vision.point_operations import Pixels

Array = NDArray[np.float64]

SEARCH_SIDE = 800
"""px of the longer side of the image in which a board is searched; its corners are then refined in
the whole image. A search takes 0.1 s at this size, and 0.4 s at 1920 x 1440."""
MIN_CORNERS = 12
"""Of a board that is seen in part; a homography takes four, and a pose should be sure."""
_WINDOW = 0.4
"""Of the distance between corners: half the side of the window of the refinement. A ChArUco board's
ends where its markers begin: their edges would draw the corner aside."""
_REFINEMENT = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 40, 1e-4)


class BoardError(ValueError):
    """A board that cannot be, or that this OpenCV cannot find, with the reason."""


@dataclass(frozen=True, eq=False)
class BoardView:
    """A board in one image."""

    points: Array  # (n, 3), of the corners on the board, m
    pixels: Array  # (n, 2), where they are seen, px
    outline: Array  # (4, 2), where the board's four outer corners of squares' corners are, px


@dataclass(frozen=True)
class Board:
    """A checkerboard, or a ChArUco board.

    Raises:
        BoardError: there is no such board.

    Examples:
        >>> Board(9, 6, 0.03).points.shape
        (54, 3)
    """

    columns: int  # inner corners along a row: one less than squares
    rows: int  # inner corners along a column
    square: float  # side of a square, m
    # OpenCV's name of a ChArUco board's dictionary, as DICT_5X5_100; empty for a checkerboard.
    dictionary: str = ''
    marker: float = 0.75  # side of a ChArUco board's markers over that of its squares

    def __post_init__(self) -> None:
        # OpenCV looks for no smaller checkerboard, and `find` takes no smaller ChArUco board.
        count, fewest = self.columns * self.rows, min(self.columns, self.rows)
        if fewest < 2 or (count < MIN_CORNERS if self.dictionary else fewest < 3):
            least = f'{MIN_CORNERS} in two rows' if self.dictionary else '3x3'
            raise BoardError(
                f'{self.columns}x{self.rows} inner corners are too few: {least} at least'
            )
        if not 0.0 < self.square < 5.0:
            raise BoardError(f'squares of {self.square:g} m cannot be; write metres, such as 0.03')
        if self.dictionary and not 0.0 < self.marker < 1.0:
            raise BoardError('markers are smaller than their squares')
        _ = self._charuco

    @cached_property
    def points(self) -> Array:
        """(n, 3), of all inner corners, m; x along a row, z is 0."""
        y, x = np.indices((self.rows, self.columns), np.float64).reshape(2, -1) * self.square
        return np.column_stack((x, y, np.zeros(len(x))))

    def find(self, gray: Pixels) -> BoardView | None:
        """The board in an image (height, width), uint8 or uint16; None where it is not seen."""
        gray = np.ascontiguousarray(in_eight_bits(gray))
        small, scale = _shrunk(gray, SEARCH_SIDE)
        corners = self._find_charuco(small) if self._charuco else self._find_plain(small)
        if corners is None:
            return None
        # The centre of the first pixel is (0, 0) in both images.
        labels, pixels = corners[0], (corners[1] + 0.5) / scale - 0.5
        points = self.points[labels]
        plane = cv2.findHomography(points[:, :2], pixels)[0]
        if plane is None or not np.isfinite(plane).all():
            return None
        apart = np.linalg.norm(pixels[:, None] - pixels, axis=2)
        np.fill_diagonal(apart, np.inf)
        window = 0.5 * (1.0 - self.marker) if self.dictionary else _WINDOW
        radius = int(np.clip(window * apart.min(), 2, 15))
        rough = np.ascontiguousarray(pixels.reshape(-1, 1, 2), np.float32)
        refined = cv2.cornerSubPix(gray, rough, (radius, radius), (-1, -1), _REFINEMENT)
        refined = np.asarray(refined, np.float64).reshape(-1, 2)
        if np.abs(refined - pixels).max() > radius:
            return None
        ends = self.points[[0, self.columns - 1, -1, -self.columns], :2].reshape(-1, 1, 2)
        outline = cv2.perspectiveTransform(ends, plane).reshape(-1, 2)
        return BoardView(points, refined, np.asarray(outline, np.float64))

    def _find_plain(self, gray: Pixels) -> tuple[NDArray[np.intp], Array] | None:
        # checkChessboard takes a tenth of the time, but misses boards that are small or oblique.
        found, pixels = cv2.findChessboardCornersSB(gray, (self.columns, self.rows))
        if not found:
            return None
        return np.arange(self.columns * self.rows), np.asarray(pixels, np.float64).reshape(-1, 2)

    @cached_property
    def _charuco(self) -> tuple[Any, ...]:
        """Detectors of the layouts that OpenCV's versions print; empty for a checkerboard."""
        if not self.dictionary:
            return ()
        aruco = getattr(cv2, 'aruco', None)
        if aruco is None:
            raise BoardError(f'this OpenCV ({cv2.__version__}) has no aruco: no ChArUco boards')
        name = self.dictionary.upper().removeprefix('DICT_')
        known = {each.upper().removeprefix('DICT_'): each for each in dir(aruco) if 'DICT_' in each}
        if name not in known:
            raise BoardError(f'no ArUco dictionary {self.dictionary}; one is DICT_5X5_100')
        dictionary = aruco.getPredefinedDictionary(getattr(aruco, known[name]))
        sides = self.square, self.marker * self.square
        size = self.columns + 1, self.rows + 1
        markers, most = size[0] * size[1] // 2, len(dictionary.bytesList)
        if markers > most:
            raise BoardError(
                f'{self.columns}x{self.rows} inner corners need {markers} markers, and '
                f'{known[name]} has {most}'
            )
        if not hasattr(aruco, 'CharucoDetector'):  # before OpenCV 4.7
            return (_OldCharucoDetector(aruco.CharucoBoard_create(*size, *sides, dictionary)),)
        boards = [aruco.CharucoBoard(size, *sides, dictionary)]
        # Before 4.6 a board with an even number of rows began with the other colour.
        if size[1] % 2 == 0 and hasattr(boards[0], 'setLegacyPattern'):
            boards.append(aruco.CharucoBoard(size, *sides, dictionary))
            boards[1].setLegacyPattern(True)
        return tuple(aruco.CharucoDetector(board) for board in boards)

    def _find_charuco(self, gray: Pixels) -> tuple[NDArray[np.intp], Array] | None:
        for detector in self._charuco:
            corners, labels = detector.detectBoard(gray)[:2]
            if labels is not None and len(labels) >= MIN_CORNERS:
                chosen = np.asarray(labels, np.intp).ravel()
                # Corners of a single row do not determine a plane.
                if min(len(np.unique(chosen // self.columns)), len(set(chosen % self.columns))) > 1:
                    return chosen, np.asarray(corners, np.float64).reshape(-1, 2)
        return None


class _OldCharucoDetector:
    """OpenCV 4.6's functions with the interface of its later classes."""

    def __init__(self, board: Any) -> None:
        self._board = board

    def detectBoard(self, gray: Pixels) -> Any:
        aruco: Any = cv2.aruco
        corners, labels, _ = aruco.detectMarkers(gray, self._board.dictionary)
        if labels is None or not len(labels):
            return None, None
        return aruco.interpolateCornersCharuco(corners, labels, gray, self._board)[1:]


def _shrunk(gray: Pixels, longest: float) -> tuple[Pixels, float]:
    """An image shrunk to a longest side (px), but not to no rows or columns; and by how much."""
    scale = min(1.0, max(longest / max(gray.shape), 1.0 / min(gray.shape)))
    return cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), scale


def in_eight_bits(gray: Pixels) -> Pixels:
    """A grey image in uint8; of uint16 from its darkest to its brightest: a camera may use 12."""
    if gray.dtype == np.uint8:
        return gray
    normalize: Any = cv2.normalize
    return np.asarray(normalize(gray, None, 0, 255, cv2.NORM_MINMAX, cv2.CV_8U))


def sharpness(gray: Pixels) -> float:
    """Of neighbouring images of one scene the sharper one has more; grey levels squared."""
    small, _ = _shrunk(gray, 0.5 * SEARCH_SIDE)
    return float(cv2.Laplacian(small, cv2.CV_32F).var())


def different_views(
    views: Sequence[BoardView], size: tuple[int, int], most: int, apart: float
) -> list[int]:
    """Which of a board's views differ from each other, those that differ most first.

    Any two differ by ``apart`` at least: the board's outer corners, root mean square, as a part
    of the diagonal of images of that size (px).
    """
    if not views:
        return []
    outlines = np.array([view.outline.ravel() for view in views])
    outlines /= np.hypot(*size) * np.sqrt(4.0)
    first = int(np.linalg.norm(outlines - outlines.mean(axis=0), axis=1).argmax())
    return farthest_first(outlines, first, most, apart)

"""Views and images of calibration boards with known cameras."""

import cv2
import numpy as np

from mvuav_ros.vision.board import Board, BoardView
from mvuav_ros.vision.camera import CameraModel

SIZE = 640, 480
BOARD = Board(9, 6, 0.03)
LENSES = {
    'plumb_bob': CameraModel(*SIZE, (600, 0, 325, 0, 602, 236, 0, 0, 1), (-0.25, 0.1, 0, 0, 0)),
    'equidistant': CameraModel(
        *SIZE, (330, 0, 315, 0, 331, 243, 0, 0, 1), (-0.02, 0.005, 0, 0), 'equidistant'
    ),
}


def view_of(camera, turn, place, noise=0.0, rng=None, board=BOARD):
    """A view of a board whose middle is at a place (m)."""
    rotation = cv2.Rodrigues(np.array(turn, float))[0]
    tvec = np.array(place) - rotation @ board.points.mean(axis=0)
    pixels = camera.project(board.points, np.array(turn, float), tvec)
    if noise:
        pixels = pixels + rng.normal(0, noise, pixels.shape)
    ends = [0, board.columns - 1, -1, -board.columns]
    return BoardView(board.points, pixels, pixels[ends])


def views_of(camera, count=40, tilt=(15, 45), noise=0.2, seed=1):
    """Views all over the image, tilted by so many degrees in any direction."""
    rng = np.random.default_rng(seed)
    views = []
    while len(views) < count:
        direction, angle = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(*tilt))
        turn = (angle * np.cos(direction), angle * np.sin(direction), rng.uniform(-0.4, 0.4))
        depth = camera.k[0] / SIZE[0] * rng.uniform(0.35, 0.6)
        x, y = rng.uniform(-0.25, 0.25, 2) * SIZE / camera.matrix[0, 0] * depth
        if tilt[1] == 0:
            turn = (0.0, 0.0, turn[2])
        view = view_of(camera, turn, (x, y, depth), noise, rng)
        if (view.pixels > 5).all() and (view.pixels < np.array(SIZE) - 6).all():
            views.append(view)
    return views

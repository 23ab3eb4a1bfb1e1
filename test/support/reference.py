"""Results of the thesis's own programs (test/data, made by tools/make_test_data.py)."""

import numpy as np

from support.places import ROOT

DATA = ROOT / 'test' / 'data'
FRAME = (480, 640)
RUNWAY_FRAME = (240, 320)
FIRST, LAST = 49, 130


def load_trial(name):
    """One flight of lights; ``frames`` holds the grey frames, even but for the cut-outs."""
    with np.load(DATA / f'{name}.npz') as data:
        trial = dict(data)
    squares, corners = trial.pop('squares'), trial.pop('corners')
    side = squares.shape[-1]
    trial['frames'] = np.full((len(squares), *FRAME), trial.pop('background'), np.uint8)
    for frame, lights, places in zip(trial['frames'], squares, corners, strict=True):
        for square, (x, y) in zip(lights, places, strict=True):
            frame[y : y + side, x : x + side] = square
    return trial


def load_runway():
    """The runway flight; ``rgb`` is black but for the red rows that were looked at."""
    with np.load(DATA / 'runway.npz') as data:
        runway = dict(data)
    red = runway.pop('red_rows')
    runway['rgb'] = np.zeros((len(red), *RUNWAY_FRAME, 3), np.uint8)
    runway['rgb'][:, FIRST:LAST, :, 0] = red
    for key in [key for key in runway if key.endswith('_packed')]:
        edges = np.unpackbits(runway.pop(key), axis=-1)[..., : red.shape[-1]]
        runway[key.removesuffix('_packed')] = edges.astype(bool)
    return runway

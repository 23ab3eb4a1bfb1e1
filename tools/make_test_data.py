"""Writes test/data from the reference results: make_test_data.py REFERENCE_FOLDER.

The thesis's programs were run under Octave on our own synthetic flights; the whole results are
large and lie outside of the project. Kept are all results that tests compare with, the
thresholded frames, square cut-outs of the grey frames around the lights, and the red rows that
the runway program looks at.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parent.parent
REACH = 20
"""px to each side of a light: its search window, its ring of background, and the light itself."""
FIRST, LAST = 49, 130
"""Rows 50 to 130 as MATLAB counts them."""
TRIALS = ('trial1', 'trial3')
RESULTS = ('A_', 'B_xy', 'B_status', 'C_velocity_fixdt', 'C_full_fixdt', 'truth_', 'README')
NOT_COMPARED = ('frametime', 'avgerr', 'stderr', 'seed_xy')


def cut_out(frames: NDArray[np.uint8], truth: NDArray[np.float64]) -> dict[str, NDArray]:
    """Squares around the lights: (frames, lights, side, side), and their top left corners."""
    height, width = frames.shape[1:]
    side = 2 * REACH + 1
    corners = np.rint(truth[: len(frames)]).astype(int) - REACH
    corners = np.clip(corners, 0, (width - side, height - side)).astype(np.int16)
    squares = np.array(
        [
            [frame[y : y + side, x : x + side] for x, y in places]
            for frame, places in zip(frames, corners, strict=True)
        ]
    )
    return {'squares': squares, 'corners': corners}


def trial(reference: Path, name: str) -> dict[str, NDArray]:
    """What is kept of one flight of lights."""
    with np.load(reference / f'{name}.npz', allow_pickle=True) as data:
        kept = {
            key: data[key]
            for key in data.files
            if key.startswith(RESULTS) and not key.endswith(NOT_COMPARED)
        }
        kept['mask_packed'] = data['mask_packed']
        kept |= cut_out(data['frames'], data['truth_xy0'])
        grey = data['frames']
    seen = np.zeros(grey.shape, bool)
    for frame, places in zip(seen, kept['corners'], strict=True):
        for x, y in places:
            frame[y : y + 2 * REACH + 1, x : x + 2 * REACH + 1] = True
    if (grey[~seen] > 178).any():
        raise SystemExit(f'{name}: a bright pixel lies outside of the cut-outs')
    kept['background'] = np.median(grey[~seen]).astype(np.uint8)
    return kept


def runway(reference: Path) -> dict[str, NDArray]:
    """What is kept of the runway flight."""
    with np.load(reference / 'runway.npz', allow_pickle=True) as data:
        kept = {key: data[key] for key in data.files if key not in ('rgb', 'segments', 'stage_s')}
        kept['red_rows'] = data['rgb'][:, FIRST:LAST, :, 0]
    for key in [key for key, array in kept.items() if array.dtype == bool]:
        kept[f'{key}_packed'] = np.packbits(kept.pop(key), axis=-1)
    return kept


def main() -> None:
    """Write the files, and say how large they are."""
    reference, folder = Path(sys.argv[1]), ROOT / 'test' / 'data'
    folder.mkdir(exist_ok=True)
    content = {name: trial(reference, name) for name in TRIALS}
    content['runway'] = runway(reference)
    for name, arrays in content.items():
        path = folder / f'{name}.npz'
        np.savez_compressed(path, **arrays)
        print(f'{path.relative_to(ROOT)}: {path.stat().st_size / 1e6:.2f} MB')


if __name__ == '__main__':
    main()

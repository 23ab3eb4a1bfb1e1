"""Damaged bags through the whole command: no traceback, no frame lost that is there."""

from __future__ import annotations

import random
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.commands import mvuav, stamp, stamps
from support.recording_samples import image_samples, mcap_ends, write_mcap

CUTS = 200
FRAMES = 12


@pytest.mark.parametrize('compression', ['zstd', 'none'])
def test_a_bag_cut_anywhere(tmp_path: Path, compression: str) -> None:
    samples = image_samples(FRAMES, 640, 480)
    bag = write_mcap(tmp_path / 'whole.mcap', samples, compression, chunk_size=1 << 20)
    content, ends = bag.read_bytes(), mcap_ends(bag)
    assert len(set(ends)) == FRAMES / 4
    choose = random.Random(compression)
    out, cut_bag = tmp_path / 'out.mcap', tmp_path / 'cut.mcap'
    answered = 0
    for _ in range(CUTS // 2):
        cut = choose.randrange(len(content))
        cut_bag.write_bytes(content[:cut])
        whole = sum(end <= cut for end in ends)
        run = mvuav('replay', cut_bag, '-o', out, '--force', '--nodes', 'marker_tracker')
        if run.status:
            assert whole == 0, (cut, run.err)
            assert run.error
            continue
        got = stamps(out)
        assert got == [stamp(n) for n in range(len(got))]
        assert len(got) >= whole, cut
        assert 'damage: cut.mcap' in run.err
        answered += len(got)
    assert answered > CUTS / 2 * FRAMES / 3


def test_frames_that_cannot_be_used_have_their_numbers_in_an_export_for_trackeval(
    tmp_path: Path,
) -> None:
    """TrackEval compares with truth by the frames' numbers."""
    folder = tmp_path / 'images'
    folder.mkdir()
    picture = np.zeros((48, 64), np.uint8)
    picture[20:23, 30:33] = 255
    for number in range(6):
        cv2.imwrite(str(folder / f'{number}.png'), picture)
    for number in (0, 3):
        (folder / f'{number}.png').write_bytes(b'cut')
    options = ('--nodes', 'marker_tracker', '--param', 'marker_tracker:mode:=detect_any')
    assert mvuav('replay', folder, '-o', tmp_path / 'out.mcap', *options).status == 0
    assert mvuav('export', tmp_path / 'out.mcap', '-o', tmp_path, '--format', 'mot').status == 0
    lines = (tmp_path / 'marker_tracker_markers.txt').read_text().splitlines()
    assert [line.split(',')[0] for line in lines] == ['2', '3', '5', '6']

"""Damaged bags through the whole command: no traceback, no frame lost that is there."""

from __future__ import annotations

import random
from pathlib import Path

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


def test_info_of_a_bag_cut_anywhere(tmp_path: Path) -> None:
    bag = write_mcap(tmp_path / 'whole.mcap', image_samples(40))
    content = bag.read_bytes()
    choose = random.Random(6)
    told = 0
    for _ in range(50):
        bag.write_bytes(content[: choose.randrange(len(content))])
        run = mvuav('info', bag)
        assert run.error if run.status else 'damage: whole.mcap: ' in run.err
        told += not run.status
    assert told > 25

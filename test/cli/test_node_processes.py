"""A ROS domain for each demo and test."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import pytest

from mvuav_ros.cli.node_processes import claim_domain


def test_nobodys_file_is_opened_for_a_domain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    victim = tmp_path / 'victim'
    victim.write_text('precious')
    shared = tmp_path / 'tmp'
    shared.mkdir()
    for number in range(1, 101):
        place = shared / f'mvuav_ros_domain_{number}'
        if number % 2:
            place.symlink_to(victim)
        else:
            os.mkfifo(place)
    monkeypatch.setattr(tempfile, 'tempdir', str(shared))
    number, claim = claim_domain()
    claim.close()
    assert 1 <= number <= 100
    assert victim.read_text() == 'precious'


def test_a_domain_is_claimed_once() -> None:
    claims = [claim_domain() for _ in range(20)]
    try:
        assert len({number for number, _ in claims}) == 20
    finally:
        for _, claim in claims:
            claim.close()

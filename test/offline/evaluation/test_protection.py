import math
from itertools import pairwise

import numpy as np
import pytest

from mvuav_ros.offline.evaluation import protection
from mvuav_ros.offline.evaluation.protection import ProtectionCounts, fly
from mvuav_ros.vision.integrity import IntegrityBudget

BUDGET = IntegrityBudget()


def test_faults_are_as_frequent_as_asked_for_and_last():
    faults = protection._Faults(np.random.default_rng(1), 0.1)
    bad = [faults.apply(np.zeros((5, 2))) for _ in range(20_000)]
    assert sum(map(len, bad)) / 100_000 == pytest.approx(0.1, rel=0.1)
    again = sum(light in later for now, later in pairwise(bad) for light in now)
    assert again / sum(map(len, bad)) == pytest.approx(0.9, abs=0.03)


@pytest.mark.parametrize('kind', protection.FAULTS)
def test_every_kind_of_fault_moves_its_light_alone(kind):
    begun = (protection._Fault(np.random.default_rng(seed), 2, 5) for seed in range(99))
    faults = protection._Faults(np.random.default_rng(0), 0.0)
    faults._of[2] = fault = next(fault for fault in begun if fault.kind == kind)
    true = np.arange(10.0).reshape(5, 2) ** 2
    pixels = true.copy()
    assert faults.apply(pixels) == [2]
    moved = np.abs(pixels - true).sum(axis=1) > 0
    assert moved.tolist() == [False, False, True, False, False]
    if kind == 'joined lights':
        before, after = (np.linalg.norm(each[2] - true[fault.other]) for each in (true, pixels))
        assert 0.5 * before <= after < before


def test_levels_hold_on_flights_with_and_without_faults():
    usual = fly(4, budget=BUDGET, frames=300)
    assert usual.frames == 300 and not usual.misleading
    assert usual.available + usual.alerts <= 300
    assert 295 - usual.faulty <= usual.available <= usual.at_distance == 300 - usual.faulty
    faulty = fly(4, budget=BUDGET, factor=1000.0, frames=300)
    assert faulty.faulty > 30 and faulty.misleading == 0
    assert faulty.silent + faulty.alerts > 0
    assert faulty.stanford[0].sum() == faulty.frames - faulty.silent


def test_levels_that_are_too_small_are_counted(monkeypatch):
    def small(*given):
        levels = protection_levels(*given)
        return type(levels)(*[0.05 * getattr(levels, name) for name in protection.COORDINATES])

    protection_levels = protection.protection_levels
    monkeypatch.setattr(protection, 'protection_levels', small)
    # With limits of no length, but for the height, all else is within them.
    monkeypatch.setattr(protection, 'ALERT_LIMITS', (math.inf, math.inf, 0.02))
    counts = fly(4, budget=BUDGET, frames=100)
    assert counts.misleading > 20 and counts.hazardous > 0
    seed, _, _, worst = counts.failures[0]
    assert seed == 4 and 'level' in worst


def test_the_bound_of_a_rate():
    # The rule of three, and Clopper and Pearson's upper bound of 2 in 100 (tables: 6.16 %).
    assert ProtectionCounts(frames=1_000_000).misleading_bound() == pytest.approx(3e-6, rel=0.01)
    bound = ProtectionCounts(frames=100, misleading=2).misleading_bound()
    assert bound == pytest.approx(0.0616, abs=2e-4)

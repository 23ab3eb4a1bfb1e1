"""Where the real footage and reference results lie; Hypothesis without a clock."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from support.places import FOOTAGE

# An example that takes long says something about the machine, not about us.
settings.register_profile(
    'any machine', deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile('any machine')


@pytest.fixture(scope='session')
def footage() -> Path:
    if not FOOTAGE.exists():
        pytest.skip(f'{FOOTAGE} is not on this machine')
    return FOOTAGE

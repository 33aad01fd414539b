"""Implicit steps through a surrogate, alone and with its true law where it must not answer."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2 import LoadCase
from surrofe2.base.sampling import SamplingRange
from surrofe2.cache import CachedLaw
from surrofe2.cache.settings import CacheSettings
from surrofe2.macro import MacroSettings, simulate
from tests.laws import CELL, TrueLattice, Untaught

LOAD_CASE = LoadCase(
    width=60.0, height=60.0, body_force=(0.0, -0.2), watched=(60.0, 30.0), elements=(2, 2),
    duration=6.0,
    output_interval=0.5,
)  # fmt: skip
EXPLICIT = MacroSettings(absolute_tolerance=1e-8, relative_tolerance=1e-6)
IMPLICIT = replace(
    EXPLICIT, integrator="implicit", absolute_tolerance=1e-7, relative_tolerance=1e-5
)


class Unbounded(Untaught):
    """A surrogate that knows no bound of its error: its range alone decides, narrower than met."""

    has_tangents, stress_spread = True, np.inf

    def __init__(self, law):
        self.cell, self.initialisation, self.density = CELL, law.initialisation, law.density
        law = replace(law, range=SamplingRange(stretch=(0.9995, 1.0005), shear=0.08, rate=0.01))
        free = replace(law, domain=None).with_tolerance(np.inf, np.inf)
        self.lookup, self.tangents = free.lookup, law.tangents


@pytest.fixture
def cached(law):
    return CachedLaw(Unbounded(law), TrueLattice(), CacheSettings(audit=0.0))


def difference(run, other):
    scale = abs(other.curve.displacement).max()
    return abs(run.curve.displacement - other.curve.displacement).max() / scale


def test_the_cached_law_moves_implicitly_as_it_does_explicitly(cached):
    runs = []
    for settings in (EXPLICIT, IMPLICIT):
        cached.reset_counts()
        runs.append(simulate(LOAD_CASE, cached, settings))
        assert min(cached.counts["hits"], cached.counts["fallbacks"]) > 20
    assert difference(runs[1], runs[0]) < 1e-3

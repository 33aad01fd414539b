"""A surrogate that is wrong in a part of its domain leaves no wrong share in what stands.

Whoever sabotages it leaves its bound as it was: labels agree, and only audits can tell.
"""

from dataclasses import replace

import numpy as np
import pytest

import surrofe2
from surrofe2 import LoadCase
from surrofe2.base.sampling import SamplingRange
from surrofe2.cache import CacheSettings
from surrofe2.cache.trust import WRONG
from surrofe2.macro import MacroSettings, simulate
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.run.displacement_curve import difference
from surrofe2.rve import RveLaw
from surrofe2.surrogate.settings import TrainingSettings
from tests.cache.tables import Kept
from tests.laws import Learnt, Truth

PRESETS = ("printed", "water")
RANGES = {
    "printed": SamplingRange(stretch=(0.91, 1.09), shear=0.09, rate=0.024),
    "water": SamplingRange(stretch=(0.96, 1.04), shear=0.075, rate=0.016),
}
SPREAD = {"printed": 70.0, "water": 16.0}
"""µN/µm: about those of the default recipes."""


def shear_of(F):
    return abs((F.transpose(0, 2, 1) @ F)[:, 0, 1]) / 2.0


def check(surrogate, law, duration, audit):
    """No window of the bar that stands is wrong; how many steps went back."""
    cached = Kept(surrogate, law, CacheSettings(audit=audit))
    run = simulate(LoadCase(duration=duration), cached, MacroSettings(frames=2))
    assert max(cached.wrong_shares(law, 1e-3 * surrogate.stress_spread), default=0.0) <= WRONG
    audited = cached.report()["audit"]
    assert audited["violations"] <= 0.5 * WRONG * audited["audited"]
    return run.rolled_back.get("steps", 0)


class Exact(Learnt):
    """The stress of the RVE itself, 5 % too large beyond a shear; its bound suspects nothing."""

    initialisation = "elastic"

    def __init__(self, law, spread, shear):
        super().__init__(None, None)
        self.law, self.shear, self.cell = law, shear, law.cell
        self.density, self.stress_spread = law.density, spread

    def lookup(self, F, F_dot, tolerance=np.inf):
        answer = self.law.respond(F, F_dot)
        stress = np.where((shear_of(F) > self.shear)[:, None, None], 1.05, 1.0) * answer.stress
        bound = self.stress_spread * (1e-5 + 1e-4 * shear_of(F))
        return stress, np.where(bound <= tolerance, answer.status, 6).astype(np.int8), bound


@pytest.mark.parametrize("preset", ["printed", pytest.param("water", marks=pytest.mark.slow)])
def test_an_answer_that_is_5_percent_off_beyond_a_shear_is_taken_back(preset):
    law = RveLaw(CellParameters.preset(preset), initialisation="elastic")
    assert check(Exact(law, SPREAD[preset], 0.01), law, 8.0, 0.3) > 0
    assert check(Exact(law, SPREAD[preset], 1.0), law, 8.0, 0.3) == 0


class Local(Learnt):
    """The stress of `Truth`, 5 % too large beyond a shear; its bound suspects nothing."""

    def __init__(self, shear):
        super().__init__(None, lambda F, F_dot: 0.01 + 0.2 * abs(F[:, 1, 0]))
        self.error = lambda F, F_dot: 0.0 * F[:, 0, 0]
        self.shear = shear

    def lookup(self, F, F_dot, limit=np.inf):
        stress, status, risk = super().lookup(F, F_dot, limit)
        stress[abs(F[:, 1, 0]) > self.shear] *= 1.05
        return stress, status, risk


@pytest.mark.parametrize(
    ("shear", "audit"), [(0.03, 0.2), pytest.param(0.07, 0.05, marks=pytest.mark.slow)]
)
def test_a_local_fault_that_an_audit_found_does_not_come_back(shear, audit):
    """By more audits than usually windows follow each other soon, and so did trust: where it came
    back below what the violations had asked for, 0.12 % of what stood was wrong, the displacement
    by 0.13 %, and as many as six windows failed."""
    load = LoadCase(elements=(12, 6), body_force=(0.0, -0.1), duration=250.0)
    settings = MacroSettings(frames=2)
    law = Kept(Local(shear), Truth(), CacheSettings(tolerance=0.01, audit=audit))
    run = simulate(load, law, settings)
    shares = [*law.wrong_shares(Truth(), 0.1)]
    sizes = [sum(len(F) for F, *_ in window) for window in law.standing]
    weights = [size for size in sizes if size]
    assert np.average(shares, weights=weights) <= 2e-4
    full = simulate(load, Truth(), settings)
    assert difference(run.curve, full.curve).largest <= 2e-4
    trust = law.history()["trust"]
    assert [event["action"] for event in trust["events"]] == ["tightened"]
    # A risk where the answer is wrong is at least this, in tolerances.
    assert trust["factor"] > 1.0 / (0.1 + 2.0 * shear * 1.05)


@pytest.fixture(scope="module", params=PRESETS)
def trained(request):
    """(surrogate with its bound, samples, true law) of a preset."""
    cell = CellParameters.preset(request.param)
    law = RveLaw(cell)
    samples = surrofe2.sample_stress(law, RANGES[request.param], 2048, seed=1)
    settings = TrainingSettings(iterations=300)
    surrogate = surrofe2.calibrate(surrofe2.train(samples, settings), samples, law)
    return surrogate, samples, law, settings


def forged(good, bad):
    """The bad surrogate under the label of the good one."""
    label = replace(good.calibration, subject=bad.network.fingerprint(bad.range))
    return replace(bad, domain=good.domain, calibration=label)


@pytest.mark.slow
@pytest.mark.parametrize("shear", [0.01, 0.02, 0.03])
def test_data_wrong_by_5_percent_beyond_a_shear(trained, shear):
    good, samples, law, settings = trained
    factor = np.where(shear_of(samples.F) > shear, 1.05, 1.0)[:, None, None]
    wrong = replace(samples, stress=factor * samples.stress, P_by_F=None, P_by_F_dot=None)
    bad = forged(good, surrofe2.train(wrong, settings))
    assert check(good, law, 60.0, 0.02) == 0
    assert check(bad, law, 60.0, 0.02) > 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("size", [0.01, 0.03])
def test_weights_that_were_disturbed(trained, size, seed):
    good, _, law, _ = trained
    random = np.random.default_rng(seed)
    tensors = {
        name: values * (1.0 + size * random.standard_normal(values.shape))
        if name.startswith(("factors", "energy."))
        else values
        for name, values in good.network.tensors.items()
    }
    bad = forged(good, replace(good, network=replace(good.network, tensors=tensors)))
    check(bad, law, 60.0, 0.05)

"""How long an RVE remembers, by what must hold for any cell."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.questions import memory
from surrofe2.questions.memory import returning, steady_shear

WATER = CellParameters.preset("water")


@pytest.fixture(scope="module")
def found():
    return memory.memory(WATER, after=2.0, micro_step=2e-3)


def test_pasts_meet_in_F_and_rate_and_the_difference_fades(found):
    steady = steady_shear(memory.RATE)
    away = returning(steady, found.period)
    for a, b in zip(steady(-1e-9), away(-1e-9), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-9)
    assert np.abs(steady(-3.0)[0] - away(-3.0)[0]).max() > 1e-3
    step = 1e-5
    for t in (-4.0, -11.0):
        slope = (away(t + step)[0] - away(t - step)[0]) / (2.0 * step)
        np.testing.assert_allclose(slope, away(t)[1], rtol=0, atol=1e-9)
    assert 0.0 < found.difference[-1] < 0.1 * found.largest
    assert found.sound
    assert found.verdict.startswith("Motions as fast as 17 µs can be cached")


def test_verdict_turns_where_the_past_matters(found):
    strict = replace(found, tolerance=1e-6)
    assert not strict.sound
    assert strict.verdict.endswith("do not cache them")


def test_an_rve_with_a_uniform_fluid_is_asked_in_the_same_way():
    """Walls ring across themselves almost undamped: the difference swings, and stays bounded."""
    uniform = CellParameters.preset("water", fluid="uniform")
    found = memory.memory(uniform, after=1.0, micro_step=2e-3)
    assert np.isfinite(found.difference).all()
    assert 0.0 < found.largest < 0.1 * found.scale


def test_fading_time():
    t = np.linspace(0.0, 10.0, 1001)
    fading = memory.Memory(17.0, t, np.exp(-t / 2.0), 1.0)
    assert fading.fading_time() == pytest.approx(2.0, abs=0.02)
    assert memory.Memory(17.0, t, np.ones_like(t), 1.0).fading_time(0.5) is None

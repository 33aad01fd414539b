"""Small-amplitude modes: known answers, dense against sparse, and the bar of RVEs."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh

from surrofe2 import LoadCase
from surrofe2.macro import MacroSettings, find_modes, find_rest, modes
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw
from tests.laws import KelvinVoigt

LOAD_CASE = LoadCase(width=60.0, height=60.0, watched=(60.0, 30.0))
# Damping in proportion to stiffness, at F = I: 2 η = 2 µ τ, ζ − η = λ τ.
TAU = 0.05
PROPORTIONAL = KelvinVoigt(
    shear_modulus=60.0, lame=80.0, shear_viscosity=60.0 * TAU, bulk_viscosity=140.0 * TAU
)
SETTINGS = MacroSettings()


def test_proportional_damping():
    """C = τ K: λ² + τ ω² λ + ω² = 0 for each undamped ω, mode shapes undamped ones."""
    rest = find_rest(LOAD_CASE, PROPORTIONAL, SETTINGS, factor=0.0)
    K = rest.stiffness.toarray()
    np.testing.assert_allclose(rest.damping.toarray(), TAU * K, atol=1e-10 * abs(K).max())
    omega2, shapes = eigh(K, rest.system.free_mass.toarray())
    omega = np.sqrt(omega2[:5])
    found = find_modes(rest, 5)
    damping = 0.5 * TAU * omega
    np.testing.assert_allclose(found.damping_ratios, damping, rtol=1e-8)
    np.testing.assert_allclose(
        found.periods, 2.0 * np.pi / (omega * np.sqrt(1.0 - damping**2)), rtol=1e-8
    )
    np.testing.assert_allclose(
        found.decrements, 2.0 * np.pi * damping / np.sqrt(1.0 - damping**2), rtol=1e-8
    )
    for shape, undamped in zip(found.shapes, shapes.T, strict=False):
        undamped = undamped / undamped[abs(undamped).argmax()]
        free = np.isin(np.arange(shape.size), rest.system.free)
        np.testing.assert_allclose(abs(shape.ravel()[free]), abs(undamped), atol=1e-6)
        assert not shape.ravel()[~free].any()
    assert found.stable


def test_longitudinal_modes_of_a_bar():
    """Without lateral contraction and as long as it is slender: ω = (j + ½) π c/W, c² = E/ρ."""
    law = KelvinVoigt(shear_modulus=60.0, lame=0.0, shear_viscosity=0.0, bulk_viscosity=0.0)
    slender = LoadCase(width=100.0, height=1.0, watched=(100.0, 0.5), elements=(32, 1))
    rest = find_rest(slender, law, SETTINGS, factor=0.0)
    found = find_modes(rest, 60)
    along = abs(found.shapes[:, :, 0]).max(axis=1) > 0.99
    across = abs(found.shapes[:, :, 1]).max(axis=1) < 0.05
    speed = np.sqrt(2.0 * 60.0 / law.density)
    expected = (np.arange(2) + 0.5) * np.pi * speed / 100.0
    omega = found.eigenvalues.imag[along & across][:2]
    np.testing.assert_allclose(omega, expected, rtol=5e-3)


def test_sparse_agrees_with_dense(monkeypatch):
    rest = find_rest(LOAD_CASE, PROPORTIONAL, SETTINGS)
    dense = find_modes(rest, 4)
    monkeypatch.setattr(modes, "DENSE_LIMIT", 0)
    sparse = find_modes(rest, 4)
    np.testing.assert_allclose(sparse.eigenvalues, dense.eigenvalues, rtol=1e-8)
    np.testing.assert_allclose(abs(sparse.shapes), abs(dense.shapes), atol=1e-6)


def test_overdamped_motions_creep():
    law = replace(PROPORTIONAL, shear_viscosity=6000.0, bulk_viscosity=14000.0)
    found = find_modes(find_rest(LOAD_CASE, law, SETTINGS, factor=0.0))
    assert found.periods.size == 0
    assert found.creeping.size == 2 * 40
    assert found.creeping.max() < 0.0
    assert found.stable


def test_bar_of_rves_has_the_period_and_damping_of_its_motion():
    """`water` on 4 × 4 (validation/paper.md), 250 µs: period 49.5 and these decrements."""
    for name, decrement in (
        ("elastic", 0.0678),
        ("constrained-runs", 0.0495),
        ("slow-manifold", 0.0411),
    ):
        law = RveLaw(CellParameters.preset("water"), initialisation=name)
        found = find_modes(find_rest(LoadCase(), law), 1)
        assert found.periods[0] == pytest.approx(49.5, rel=2e-3)
        assert found.decrements[0] == pytest.approx(decrement, rel=1e-2)
        assert found.stable

"""A look into RVEs: particles, forces and pressures in plain numpy against the kernels' stress."""

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw
from tests.numerics import turn
from tests.rve import rves

F = np.eye(2) + 0.02 * np.random.default_rng(3).normal(size=(5, 2, 2))
F_DOT = 0.004 * np.random.default_rng(4).normal(size=(5, 2, 2))


@pytest.mark.parametrize(
    "initialisation", ["slow-manifold", "constrained-runs", "elastic", "cauchy-born"]
)
@pytest.mark.parametrize("preset", ["printed", "water"])
def test_virial_of_the_particles_is_the_stress_of_the_law(preset, initialisation):
    law = rves.law(preset, initialisation)
    stress, seen = law.respond(F, F_DOT).stress, law.particles(F, F_DOT)
    np.testing.assert_allclose(seen.stress, stress, rtol=0, atol=1e-10 * abs(stress).max())


@pytest.mark.parametrize("preset", ["printed", "water"])
def test_particles_are_in_equilibrium(preset):
    law = rves.law(preset, "slow-manifold")
    seen = law.particles(F, F_DOT)
    mean = np.linalg.norm(seen.force, axis=2).mean(axis=1)
    assert (mean < 2.0 * law.settings.tolerance).all()
    assert abs(seen.force.sum(axis=1)).max() < 1e-9 * seen.tension.max()


def test_area_of_cells_follows_the_deformation():
    law = RveLaw(CellParameters.preset("water", cells=4))
    seen = law.particles(F, 0.0 * F_DOT)
    assert seen.area_ratio.shape == (5, 4)
    np.testing.assert_allclose(seen.area_ratio.mean(axis=1), np.linalg.det(F), rtol=1e-2)


def test_fluid_pushes_on_the_walls_with_what_their_tension_carries():
    """At rest half a square cell is in balance: wall tension T, fluid on the opposite side p L."""
    law = rves.law("water", "slow-manifold")
    still = np.eye(2)[None]
    seen = law.particles(still, 0.0 * still)
    assert seen.area_ratio == pytest.approx(1.0, rel=1e-9)
    pushes = seen.contact_pressure[0, 1:]  # without the corner, which four plant cells push
    assert pushes.mean() == pytest.approx(seen.tension.mean() / law.cell.cell_side, rel=0.15)
    assert seen.extremes()["highest_turgor_uN_per_um"] >= seen.pressure.mean()


def test_a_rotation_turns_the_particles_and_changes_nothing_else():
    law, Q = rves.law("water", "slow-manifold"), turn(0.6)
    seen, turned = law.particles(F, 0.0 * F), law.particles(Q @ F, 0.0 * F)
    np.testing.assert_allclose(turned.pressure, seen.pressure, rtol=1e-6)
    np.testing.assert_allclose(turned.stretch, seen.stretch, rtol=1e-6)
    np.testing.assert_allclose(turned.position, seen.position @ Q.T, atol=1e-5)


def test_a_point_without_stress_is_named():
    with pytest.raises(InputError, match="point 1: the RVE"):
        rves.law("water").particles(np.stack([np.eye(2), np.diag([1.9, 0.4])]), np.zeros((2, 2, 2)))

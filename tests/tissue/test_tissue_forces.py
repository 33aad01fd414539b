"""Forces of a tissue against the numpy twin, the RVE and identities."""

from __future__ import annotations

import numpy as np
import pytest

from surrofe2.base.simd import TILE
from surrofe2.tissue import TissueDynamics, make_tissue
from tests.numerics import assert_near, slope_along
from tests.plant_cell.twin import Twin
from tests.tissue.twin import TissueTwin


def shaken(tissue, seed=0, amount=0.1):
    """Positions and velocities around the repeated reference, (particles, 2) each."""
    numbers = np.random.default_rng(seed)
    x = tissue.to_particles(tissue.start)
    return (
        x + amount * numbers.uniform(-1, 1, x.shape),
        0.2 * numbers.uniform(-1, 1, x.shape),
    )


def placed(tissue, x, v):
    dynamics = TissueDynamics(tissue)
    dynamics.place(x, v)
    return dynamics


@pytest.fixture(params=[((2, 2), "printed"), ((3, 2), "water"), ((1, 1), "water")])
def case(request, tissue_of, reference):
    cells, preset = request.param
    tissue = tissue_of(cells, preset)
    twin = TissueTwin(*reference(preset), cells)
    at = tissue.to_particles(tissue.start)
    distance = np.linalg.norm(at[:, None] - twin.start, axis=2)
    assert tissue.particles == len(twin.start)
    assert distance.min(axis=1).max() < 1e-9
    return tissue, twin, distance.argmin(axis=1)


def test_forces_energy_and_dissipation_are_those_of_the_twin(case):
    tissue, twin, order = case
    x, v = shaken(tissue)
    dynamics = placed(tissue, x, v)
    there = np.empty_like(x), np.empty_like(v)
    there[0][order], there[1][order] = x, v
    f, energy, lost = twin.evaluate(*there)
    assert_near(dynamics.forces(), f[order], 1e-10)
    assert dynamics.elastic_energy() == pytest.approx(energy, rel=1e-12)
    assert dynamics.dissipation_rate() == pytest.approx(lost, rel=1e-10)
    np.testing.assert_array_equal(tissue.mass.reshape(-1)[tissue.where], twin.mass[order])


@pytest.fixture(params=[((2, 2), "printed"), ((3, 2), "water"), ((1, 1), "water"), None])
def any_tissue(request, tissue_of, types):
    """Tissues of one plant cell, and one of two types."""
    if request.param is not None:
        return tissue_of(*request.param)
    return make_tissue(*types, np.array([[0, 1], [1, 1], [0, 0]]))


def test_mass_is_that_of_the_macro_scale(any_tissue, types):
    cells = types[0] if any_tissue.kind.any() else [any_tissue.cell]
    mass = sum(cells[k].density for k in any_tissue.kind.ravel()) * any_tissue.cell.cell_side**2
    assert any_tissue.mass.sum() == pytest.approx(mass, rel=1e-13)


def test_paper_s_bar_has_its_particles(tissue_of):
    tissue = tissue_of((16, 16))
    assert (tissue.particles, tissue.wall_particles) == (9281, 5185)


def test_forces_sum_to_zero(any_tissue):
    f = placed(any_tissue, *shaken(any_tissue)).forces()
    assert abs(f.sum(axis=0)).max() < 1e-12 * abs(f).max() * len(f)


def test_force_is_minus_the_gradient_of_the_energy(any_tissue):
    x, v = shaken(any_tissue)
    dynamics = placed(any_tissue, x, 0.0 * v)
    f = dynamics.forces()

    def energy(x):
        dynamics.place(x)
        return dynamics.elastic_energy()

    for seed in range(3):
        direction = np.random.default_rng(seed).normal(size=x.shape)
        slope = slope_along(energy, x, direction, 1e-4)
        size = np.linalg.norm(f) * np.linalg.norm(direction)
        assert slope == pytest.approx(-np.sum(f * direction), abs=1e-7 * size)


@pytest.mark.parametrize("preset", ["water", "printed"])
def test_inside_under_affine_deformation_is_an_rve(preset, tissue_of, reference):
    """Particles at F X with velocities Ḟ X: Cauchy–Born (eq. 64)."""
    cell, at_rest = reference(preset)
    F = np.array([[1.05, 0.06], [-0.03, 0.96]])
    F_dot = np.array([[0.01, -0.004], [0.006, 0.008]])
    tissue = tissue_of((5, 5), preset)
    X = tissue.to_particles(tissue.start)
    dynamics = placed(tissue, X @ F.T, X @ F_dot.T)
    tile, lane = np.divmod(tissue.place[2, 2], TILE)
    middle = np.flatnonzero(
        (tissue.where // TILE // tissue.own == tile) & (tissue.where % TILE == lane)
    )
    f, *_ = Twin(cell, at_rest.rest_length).evaluate(at_rest.position, F, F_dot)
    assert len(middle) == len(f)
    assert_near(dynamics.forces()[middle], f, 1e-10)

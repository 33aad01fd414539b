"""RVEs of several plant cells: squares over again, hexagons with D6, Voronoi with no symmetry."""

from functools import cache

import numpy as np
import pytest

from surrofe2.law.stress_law import Status
from surrofe2.plant_cell.block_matrices import dense_pattern
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import INITIALISATIONS, RveLaw, RveSettings
from surrofe2.rve.unit_cell import relax
from tests.numerics import assert_tangents_near, turn
from tests.rve import rves


@cache
def law(arrangement, cells, initialisation="constrained-runs", solver="direct", **settings):
    cell = CellParameters(arrangement=arrangement, cells=cells, fluid="sph")
    return RveLaw(cell, RveSettings(initialisation=initialisation, solver=solver, **settings))


F, F_DOT = rves.deformations("water", 8, corners=False)


@pytest.mark.parametrize(
    ("arrangement", "initialisation"),
    [
        ("square", "cauchy-born"),
        ("square", "elastic"),
        ("square", "constrained-runs"),
        pytest.param("square", "slow-manifold", marks=pytest.mark.slow),  # a minute to compile
        ("hexagon", "constrained-runs"),
    ],
)
def test_two_by_two_plant_cells_are_one(arrangement, initialisation):
    four, one = law(arrangement, 4, initialisation), law(arrangement, 1, initialisation)
    assert len(four.unit_cell.topology.width) > 1  # groups
    assert len(one.unit_cell.topology.width) == 1
    assert four.rest_length == pytest.approx(one.rest_length, abs=1e-11)
    assert four.density == pytest.approx(one.density, rel=1e-14)
    mine, theirs = (this.respond(F, F_DOT, tangents=True) for this in (four, one))
    np.testing.assert_allclose(mine.stress, theirs.stress, rtol=0, atol=1e-9)
    assert_tangents_near(mine.tangents, theirs.tangents, 1e-6)


def test_warm_start_needs_no_newton_with_sparse_factors():
    this = law("square", 4)
    cold = this.respond(F, F_DOT)
    warm = this.respond(F * 1.0005, F_DOT, cold.state)
    assert warm.effort["newton_solves"] == 0
    fresh = this.respond(F * 1.0005, F_DOT).stress
    np.testing.assert_allclose(warm.stress, fresh, rtol=0, atol=1e-8)
    assert (this.accept(F * 1.0005, F_DOT, warm).status == Status.OK).all()


@pytest.mark.parametrize("initialisation", ["constrained-runs", "slow-manifold"])
def test_hexagons_have_the_symmetry_d6(initialisation):
    this = law("hexagon", 1, initialisation)
    stress = this.respond(F, F_DOT).stress
    assert np.isfinite(stress).all()
    for k in range(1, 6):
        G = turn(k * np.pi / 3)
        np.testing.assert_allclose(this.respond(F @ G, F_DOT @ G).stress, stress, rtol=0, atol=1e-9)
        M = G @ np.diag([1.0, -1.0])
        there = this.respond(M @ F @ M, M @ F_DOT @ M).stress
        np.testing.assert_allclose(there, M @ stress @ M, rtol=0, atol=1e-9)
    G = np.array([[0.0, -1.0], [1.0, 0.0]])  # a quarter turn is none of them
    assert np.abs(this.respond(F @ G, F_DOT @ G).stress - stress).max() > 1e-3


@pytest.mark.parametrize("arrangement", ["square", "hexagon"])
def test_plant_cells_rest_without_stress(arrangement):
    F = np.broadcast_to(np.eye(2), (3, 2, 2))
    for name in INITIALISATIONS:
        answer = law(arrangement, 1, name).respond(F, np.zeros_like(F))
        assert (answer.status == Status.OK).all()
        assert np.abs(answer.stress).max() < 1e-9


def test_sparse_and_dense_matrices_find_the_same_equilibrium():
    unit = law("square", 4).unit_cell
    z = np.broadcast_to(unit.position.T, (8, *unit.position.T.shape))
    dense = unit.topology._replace(**dense_pattern(unit.topology.particles)._asdict())
    assert len(unit.topology.width) > len(dense.width) == 1
    found = [relax(each, unit.constants, z, F) for each in (unit.topology, dense)]
    np.testing.assert_allclose(found[0].stress, found[1].stress, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found[0].energy, found[1].energy, rtol=1e-13)
    np.testing.assert_array_equal(found[0].stable, found[1].stable)
    assert found[0].stable.all()

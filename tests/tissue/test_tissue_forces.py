"""Forces of a tissue of one type of plant cell and of two: numpy twin, RVE and identities."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.base.simd import TILE
from surrofe2.tissue import make_tissue
from tests.numerics import assert_near
from tests.plant_cell.twin import Twin
from tests.tissue.motion import assert_force_is_minus_the_gradient_of_the_energy, placed, shaken
from tests.tissue.twin import TissueTwin

ONE_TYPE = [((2, 2), "printed"), ((3, 2), "water"), ((1, 1), "water")]


@pytest.mark.parametrize(("cells", "preset"), ONE_TYPE)
def test_forces_energy_and_dissipation_are_those_of_the_twin(tissue_of, cells, preset):
    tissue = tissue_of(cells, preset)
    twin, (x, v) = TissueTwin(tissue), shaken(tissue)
    dynamics = placed(tissue, x, v)
    f, energy, lost = twin.evaluate(x, v)
    assert_near(dynamics.forces(), f, 1e-10)
    assert dynamics.elastic_energy() == pytest.approx(energy, rel=1e-12)
    assert dynamics.dissipation_rate() == pytest.approx(lost, rel=1e-10)
    np.testing.assert_array_equal(dynamics.mass, twin.mass)


@pytest.fixture(params=[*ONE_TYPE, None])
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
    assert (tissue.particles, tissue.is_wall.sum()) == (9281, 5185)


def test_forces_sum_to_zero(any_tissue):
    f = placed(any_tissue, *shaken(any_tissue)).forces()
    assert abs(f.sum(axis=0)).max() < 1e-12 * abs(f).max() * len(f)


def test_force_is_minus_the_gradient_of_the_energy(any_tissue):
    x, _ = shaken(any_tissue)
    assert_force_is_minus_the_gradient_of_the_energy(any_tissue, x, step=1e-4, directions=3)


@pytest.mark.parametrize("preset", ["water", "printed"])
def test_inside_under_affine_deformation_is_an_rve(preset, tissue_of, reference):
    """Particles at F X with velocities Ḟ X: Cauchy–Born (eq. 64)."""
    cell, at_rest = reference(preset)
    F = np.array([[1.05, 0.06], [-0.03, 0.96]])
    F_dot = np.array([[0.01, -0.004], [0.006, 0.008]])
    tissue = tissue_of((5, 5), preset)
    X = tissue.to_particles(tissue.start)
    dynamics = placed(tissue, X @ F.T, X @ F_dot.T)
    here = np.divmod(tissue.place[2, 2], TILE)
    middle = np.flatnonzero((tissue.address[:, [0, 2]] == here).all(axis=1))
    f, *_ = Twin(cell, at_rest.rest_length).evaluate(at_rest.position, F, F_dot)
    assert len(middle) == len(f)
    assert_near(dynamics.forces()[middle], f, 1e-10)


def test_equal_types_are_one_type(types):
    (cell, _), (at_rest, _) = types
    kind = np.array([[0, 1, 0], [1, 1, 0]])
    tissues = make_tissue([cell], [at_rest], 0 * kind), make_tissue([cell] * 2, [at_rest] * 2, kind)
    one, two = (placed(tissue, *shaken(tissues[0])) for tissue in tissues)
    for dynamics in (one, two):
        steps = np.full(40, 1e-3)
        dynamics.leap(steps, steps)
    for name in ("x", "v", "f"):
        assert_near(getattr(two, name), getattr(one, name), 1e-12)
    assert two.elastic_energy() == pytest.approx(one.elastic_energy(), rel=1e-12)
    assert two.dissipation_rate() == pytest.approx(one.dissipation_rate(), rel=1e-10)


def test_a_wall_between_two_types_is_half_of_each(types):
    """Forces and masses of A|B and B|A add up to those of A|A and B|B at the same particles."""
    kinds = np.array([[[0], [1]], [[1], [0]], [[0], [0]], [[1], [1]]])
    tissues = [make_tissue(*types, kind) for kind in kinds]
    found = [placed(tissue, *shaken(tissues[0], amount=0.3)) for tissue in tissues]
    forces, masses = ([each.forces() for each in found], [each.mass for each in found])
    lost = [each.dissipation_rate() for each in found]
    for ab, ba, aa, bb in (forces, masses):
        np.testing.assert_allclose(ab + ba, aa + bb, rtol=0, atol=1e-11 * abs(ab).max())
        assert abs(ab - ba).max() > 1e-3 * abs(ab).max()
    assert lost[0] + lost[1] == pytest.approx(lost[2] + lost[3], rel=1e-11)


def test_mirrored_types_have_mirrored_forces(types):
    """So neither side owns the wall between them."""
    ab, ba = (make_tissue(*types, np.array(kind)) for kind in ([[0], [1]], [[1], [0]]))
    x, v = shaken(ab)
    mirror = np.array([-1.0, 1.0])
    across = np.array([50.0, 0.0]) + mirror * ab.to_particles(ab.start)
    there = ba.to_particles(ba.start)
    order = np.linalg.norm(across[:, None] - there, axis=2).argmin(axis=1)
    assert len(set(order)) == ab.particles
    mirrored = np.empty_like(x), np.empty_like(v)
    mirrored[0][order], mirrored[1][order] = np.array([50.0, 0.0]) + mirror * x, mirror * v
    found = placed(ba, *mirrored).forces()[order]
    assert_near(found, mirror * placed(ab, x, v).forces(), 1e-9)


@pytest.mark.parametrize("change", [{"cell_side": 30.0}, {"repulsion_cutoff": 9.0}])
def test_cells_that_cannot_meet_are_refused(types, change):
    cell, at_rest = types[0][0], types[1][0]
    with pytest.raises(InputError, match=rf"^cell\.{next(iter(change))}: .* must share it"):
        make_tissue([cell, replace(cell, **change)], [at_rest] * 2, np.array([[0, 1]]))

"""Plant cells of several types: equal ones change nothing, unlike ones share walls by halves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.tissue import make_tissue
from tests.numerics import assert_near
from tests.tissue.test_tissue_forces import placed, shaken


def tissue_of(types, kind):
    return make_tissue(*types, np.array(kind))


def test_equal_types_are_one_type(types):
    (cell, _), (at_rest, _) = types
    kind = np.array([[0, 1, 0], [1, 1, 0]])
    tissues = make_tissue([cell], [at_rest], 0 * kind), make_tissue([cell] * 2, [at_rest] * 2, kind)
    one, two = (placed(tissue, *shaken(tissues[0])) for tissue in tissues)
    for dynamics in (one, two):
        steps = np.full(40, 1e-3)
        dynamics.leap(steps, steps, np.zeros(40))
    for name in ("x", "v", "f"):
        assert_near(getattr(two, name), getattr(one, name), 1e-12)
    assert two.elastic_energy() == pytest.approx(one.elastic_energy(), rel=1e-12)
    assert two.dissipation_rate() == pytest.approx(one.dissipation_rate(), rel=1e-10)


def test_a_wall_between_two_types_is_half_of_each(types):
    """Forces and masses of A|B and B|A add up to those of A|A and B|B at the same particles."""
    tissues = [tissue_of(types, kind) for kind in ([[0], [1]], [[1], [0]], [[0], [0]], [[1], [1]])]
    found = [placed(tissue, *shaken(tissues[0], amount=0.3)) for tissue in tissues]
    forces, masses = ([each.forces() for each in found], [each.mass for each in found])
    lost = [each.dissipation_rate() for each in found]
    for ab, ba, aa, bb in (forces, masses):
        np.testing.assert_allclose(ab + ba, aa + bb, rtol=0, atol=1e-11 * abs(ab).max())
        assert abs(ab - ba).max() > 1e-3 * abs(ab).max()
    assert lost[0] + lost[1] == pytest.approx(lost[2] + lost[3], rel=1e-11)


def test_mirrored_types_have_mirrored_forces(types):
    """So neither side owns the wall between them."""
    ab, ba = (tissue_of(types, kind) for kind in ([[0], [1]], [[1], [0]]))
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

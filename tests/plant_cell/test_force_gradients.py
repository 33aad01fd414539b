"""Slopes of weighted force sums, and of the elastic stiffness, against what they derive from."""

import numpy as np
import pytest

from surrofe2.base.simd import TILE
from surrofe2.plant_cell import forces
from surrofe2.plant_cell.derivatives import add_force_gradients, add_stiffness_rates
from tests.numerics import assert_near, slope_along
from tests.plant_cell.lanes_of_states import Patch


class Local(Patch):
    """A patch with the velocities of any motion and four fields over local particles."""

    def __init__(self, preset):
        super().__init__(preset)
        self.owners = np.concatenate([np.arange(self.topology.particles), self.topology.owner])
        rng = np.random.default_rng(7)
        self.x = self.local(self.z, self.F)
        self.v = self.local(self.z, self.F_dot)
        self.fields = rng.normal(size=(4, 2, len(self.owners), TILE))
        self.others = rng.normal(size=self.fields.shape)

    def gradients(self, weights):
        by_x, by_v = np.zeros_like(weights), np.zeros_like(weights)
        work = self.workspace(self.x, self.v)
        add_force_gradients(work, weights, by_x, by_v, self.topology, self.constants)
        return by_x, by_v

    def all_forces(self, x, v):
        work = self.workspace(x, v)
        forces.local_forces(work, self.topology, self.constants)
        return work.f

    def stiffness_rates(self, u, v):
        f = np.zeros_like(u)
        add_stiffness_rates(self.workspace(self.x, v), u, f, self.topology, self.constants)
        return f


@pytest.fixture(params=["printed", "water"])
def local(request):
    return Local(request.param)


def along(first, second):
    """(4, TILE): products of fields, summed over particles."""
    return np.einsum("mapl,mapl->ml", first, second)


def test_gradients_are_the_slopes_of_the_weighted_sum(local):
    """Images have weights of their own here, as they have in the virial."""
    by_x, by_v = local.gradients(local.fields)
    for forces_at, at, by in (
        (lambda x: local.all_forces(x, local.v), local.x, by_x),
        (lambda v: local.all_forces(local.x, v), local.v, by_v),
    ):
        slope = along(by, local.others)
        expected = [slope_along(forces_at, at, each, 1e-6) for each in local.others]
        assert_near(along(local.fields, np.array(expected)), slope, 1e-6)


def test_gradients_are_the_transposed_jacobian(local):
    n, (J, columns) = local.topology.particles, local.jacobian(local.F_dot)
    L = np.moveaxis(local.F_dot @ np.linalg.inv(local.F), 0, -1)
    Z = local.local(local.z, np.broadcast_to(np.eye(2), local.F.shape))
    weights = np.ascontiguousarray(local.fields[:, :, local.owners])
    by_x, by_v = local.gradients(weights)
    own = weights[:, :, :n].swapaxes(1, 2).reshape(4, 2 * n, TILE)
    for fields, first in ((by_x, 0), (by_v, 4)):
        affine = np.einsum("mckl,dkl->mcdl", fields, Z).reshape(4, 4, TILE)
        expected = np.einsum("mil,ijl->mjl", own, columns[:, first : first + 4])
        assert_near(affine, expected, 1e-12)
    weights[:, :, local.owners == 0] = 0.0  # forces on the held particle are in no matrix
    by_x, by_v = local.gradients(weights)
    total = by_x + np.einsum("cal,mckl->makl", L, by_v)
    folded = np.zeros((4, 2, n, TILE))
    np.add.at(folded, (slice(None), slice(None), local.owners), total)
    folded = folded.swapaxes(1, 2).reshape(4, 2 * n, TILE)
    own = weights[:, :, 1:n].swapaxes(1, 2).reshape(4, 2 * n - 2, TILE)
    assert_near(folded[:, 2:], np.einsum("mil,ijl->mjl", own, J), 1e-12)


def test_stiffness_rates_are_the_slopes_of_the_elastic_force_rates(local):
    rates = local.stiffness_rates(local.fields, local.v)
    rates_at = lambda x: local.elastic_rates(x, local.v)[1]  # noqa: E731
    for found, field in zip(rates, local.fields, strict=True):
        assert_near(slope_along(rates_at, local.x, field, 1e-6), found, 1e-6)

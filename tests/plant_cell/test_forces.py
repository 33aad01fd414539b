"""Pair laws, kernels and their derivatives against identities and the plain numpy twin."""

import numpy as np
import pytest
from numba import njit
from scipy.integrate import quad

from surrofe2.base.simd import TILE, load, pack, store, unpack
from surrofe2.plant_cell import forces
from surrofe2.plant_cell.derivatives import add_stiffness_rates
from surrofe2.plant_cell.pair_laws import spline, spline_curvature, spline_slope
from tests.numerics import assert_near, differences, slope_along
from tests.plant_cell.lanes_of_states import Patch


def call_kernel(law):
    """A pair law as a function of arrays, compiled as kernels compile it."""

    @njit
    def evaluate(tile, h):
        for i in range(tile.shape[0]):
            store(law(load(tile, i) / h, h), tile, i)

    def of(r, h):
        tile = np.repeat(np.asarray(r)[:, None], TILE, axis=1)
        evaluate(tile, h)
        return tile[:, 0]

    return of


@pytest.fixture(params=["printed", "water"])
def patch(request):
    return Patch(request.param)


def test_smoothing_kernel_integrates_to_one_and_its_slopes_are_its_derivatives():
    h = 5.5
    w, slope, curvature = map(call_kernel, (spline, spline_slope, spline_curvature))
    at = lambda law, r: law(np.array([r]), h)[0]  # noqa: E731
    total, _ = quad(lambda r: 2 * np.pi * r * at(w, r), 0, 2 * h, points=[h])
    assert total == pytest.approx(1.0, abs=1e-12)
    r = np.array([0.3, 2.0, 5.0, 6.0, 9.0, 10.9])
    for law, derivative in ((w, slope), (slope, curvature)):
        expected = slope_along(lambda r, law=law: law(r, h), r, 1.0, 1e-5)
        np.testing.assert_allclose(derivative(r, h), expected, rtol=1e-7, atol=1e-12)
    assert w(np.array([11.0, 12.0]), h).tolist() == [0.0, 0.0]


def test_forces_are_those_of_the_twin(patch):
    f = patch.forces()
    for lane in range(3):
        expected, *_ = patch.twin.evaluate(patch.z[lane], patch.F[lane], patch.F_dot[lane])
        assert_near(f[lane], expected, 1e-10)


def test_forces_sum_to_zero(patch):
    f = patch.forces()
    assert abs(f.sum(axis=1)).max() < 1e-12 * abs(f).max() * patch.topology.particles


@pytest.mark.parametrize("term", ["bonds", "contacts", "fluid_pairs"])
def test_each_term_alone_is_a_gradient(patch, term):
    empty = np.empty((0, 2), dtype=np.int32)
    others = {"bonds", "contacts", "fluid_pairs"} - {term}
    patch.topology = patch.topology._replace(**dict.fromkeys(others, empty))
    if term != "fluid_pairs":
        patch.constants = patch.constants._replace(sound_speed_squared=0.0)
    f = patch.forces(F_dot=np.zeros_like(patch.F_dot))
    direction = np.random.default_rng(3).normal(size=patch.z.shape)
    moved = np.einsum("lab,lpb->lpa", patch.F, direction)
    slope = slope_along(lambda z: patch.energy(z, patch.F), patch.z, direction, 1e-4)
    work = (f * moved).sum(axis=(1, 2))
    assert abs(work).min() > 0
    assert_near(-slope, work, 1e-6)


def test_dashpots_only_dissipate(patch):
    """Power of the velocity-dependent forces in an affine motion, pair by pair the same sign."""
    moving = patch.forces(fold=False)
    still = patch.forces(F_dot=np.zeros_like(patch.F_dot), fold=False)
    assert abs(moving - still).max() > 1e-3
    for lane in range(TILE):
        args = patch.z[lane], patch.F[lane]
        _, _, with_rate = patch.twin.evaluate(*args, patch.F_dot[lane])
        _, _, without = patch.twin.evaluate(*args, np.zeros((2, 2)))
        L = patch.F_dot[lane] @ np.linalg.inv(patch.F[lane])
        assert np.sum((with_rate - without) * L) > 0


def test_jacobian_and_load_are_the_derivatives_of_the_forces(patch):
    z, F, F_dot = patch.z, patch.F, patch.F_dot
    n, (J, load) = patch.topology.particles, patch.jacobian(F_dot)
    inverse = np.linalg.inv(F)
    for column in range(0, 2 * n - 2, 3):
        i, axis = divmod(column + 2, 2)
        shift = np.zeros_like(z)
        shift[:, i] = inverse[:, :, axis]
        slope = slope_along(patch.forces, z, shift, 1e-6).reshape(TILE, -1)[:, 2:]
        np.testing.assert_allclose(J[:, column].T, slope, rtol=0, atol=1e-6 * abs(J).max())
    by_F = differences(lambda at: patch.forces(z, at, F_dot), F, 1e-7)
    by_F_dot = differences(lambda at: patch.forces(z, F, at), F_dot, 1e-7)
    slopes = np.concatenate([each.reshape(TILE, 2 * n, 4) for each in (by_F, by_F_dot)], axis=2)
    for column in range(8):
        assert_near(slopes[:, :, column], load[:, column].T, 1e-6)


def test_elastic_force_rates_are_the_slopes_along_a_motion(patch):
    """For any motion of the particles with a moving lattice, fluctuating ones included."""
    n = patch.topology.particles
    y = 0.1 * np.random.default_rng(5).normal(size=patch.z.shape)
    x, v = patch.x, patch.v.copy()
    v += np.einsum("lab,lpb->apl", patch.F, y[:, patch.owners])
    found, still = patch.elastic_rates(x, v), np.zeros_like(patch.F_dot)
    for each in found:
        forces.fold_images(each, patch.topology)
    f, rate = (np.moveaxis(each[:, :n], -1, 0).swapaxes(1, 2) for each in found)
    np.testing.assert_allclose(f, patch.forces(F_dot=still), rtol=0, atol=1e-9)
    moving = lambda t: patch.forces(patch.z + t * y, patch.F + t * patch.F_dot, still)  # noqa: E731
    slope = slope_along(moving, 0.0, 1.0, 1e-5)
    assert_near(rate, slope, 1e-6)


def test_elastic_jacobian_is_symmetric(patch):
    J, _ = patch.jacobian(np.zeros_like(patch.F_dot))
    assert abs(J - J.swapaxes(0, 1)).max() < 1e-12 * abs(J).max()


def test_packing_into_tiles_is_undone_by_unpacking():
    values = np.random.default_rng(0).normal(size=(19, 2, 3))
    tiles = pack(values)
    assert tiles.shape == (3, 2, 3, TILE)
    np.testing.assert_array_equal(unpack(tiles, 19), values)
    np.testing.assert_array_equal(tiles[2, :, :, 7], values[18])


@pytest.fixture
def fields(patch):
    """Two times four fields of local particles."""
    return np.random.default_rng(7).normal(size=(2, 4, *patch.x.shape))


def along(first, second):
    """(4, TILE): products of fields, summed over particles."""
    return np.einsum("mapl,mapl->ml", first, second)


def test_gradients_are_the_slopes_of_the_weighted_sum(patch, fields):
    """Images have weights of their own here, as they have in the virial."""
    weights, others = fields
    by_x, by_v = patch.gradients(weights)
    for forces_at, at, by in (
        (lambda x: patch.local_forces(x, patch.v), patch.x, by_x),
        (lambda v: patch.local_forces(patch.x, v), patch.v, by_v),
    ):
        slope = along(by, others)
        expected = [slope_along(forces_at, at, each, 1e-6) for each in others]
        assert_near(along(weights, np.array(expected)), slope, 1e-6)


def test_gradients_are_the_transposed_jacobian(patch, fields):
    n, (J, columns) = patch.topology.particles, patch.jacobian(patch.F_dot)
    L = np.moveaxis(patch.F_dot @ np.linalg.inv(patch.F), 0, -1)
    Z = patch.local(patch.z, np.broadcast_to(np.eye(2), patch.F.shape))
    weights = np.ascontiguousarray(fields[0][:, :, patch.owners])
    by_x, by_v = patch.gradients(weights)
    own = weights[:, :, :n].swapaxes(1, 2).reshape(4, 2 * n, TILE)
    for by, first in ((by_x, 0), (by_v, 4)):
        affine = np.einsum("mckl,dkl->mcdl", by, Z).reshape(4, 4, TILE)
        expected = np.einsum("mil,ijl->mjl", own, columns[:, first : first + 4])
        assert_near(affine, expected, 1e-12)
    weights[:, :, patch.owners == 0] = 0.0  # forces on the held particle are in no matrix
    by_x, by_v = patch.gradients(weights)
    total = by_x + np.einsum("cal,mckl->makl", L, by_v)
    folded = np.zeros((4, 2, n, TILE))
    np.add.at(folded, (slice(None), slice(None), patch.owners), total)
    folded = folded.swapaxes(1, 2).reshape(4, 2 * n, TILE)
    own = weights[:, :, 1:n].swapaxes(1, 2).reshape(4, 2 * n - 2, TILE)
    assert_near(folded[:, 2:], np.einsum("mil,ijl->mjl", own, J), 1e-12)


def test_stiffness_rates_are_the_slopes_of_the_elastic_force_rates(patch, fields):
    work, rates = patch.workspace(patch.x, patch.v), np.zeros_like(fields[0])
    add_stiffness_rates(work, fields[0], rates, patch.topology, patch.constants)
    rates_at = lambda x: patch.elastic_rates(x, patch.v)[1]  # noqa: E731
    for rate, field in zip(rates, fields[0], strict=True):
        assert_near(slope_along(rates_at, patch.x, field, 1e-6), rate, 1e-6)

"""Rotation, the square cell's group, rest and smoothness of a trained network; cells without it."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from surrofe2.base.sampling import sample
from surrofe2.base.square_symmetry import parity
from surrofe2.base.tensors import to_components
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.surrogate import TrainingSettings, train
from surrofe2.surrogate.features import COVARIANTS, INVARIANTS, monomials
from surrofe2.surrogate.network import Shapes, along
from tests.laws import CELL, WELL_INSIDE, lattice_samples, lattice_stress
from tests.numerics import assert_near, turn
from tests.surrogate.twins import ROTATIONS, G, make_network, torch_stress


@pytest.fixture(scope="module")
def points():
    F, F_dot = sample(WELL_INSIDE, 200, seed=11)
    R = turn(np.linspace(-3.0, 3.0, 200))
    return R @ F, R @ F_dot


IRREGULAR = CellParameters.preset("printed", arrangement="voronoi", cells=9)


def turned_samples(cell, count=1500):
    samples = lattice_samples(count, cell=cell)
    return replace(samples, stress=lattice_stress(samples.F @ turn(0.3), samples.F_dot @ turn(0.3)))


@pytest.fixture(scope="module")
def irregular():
    settings = TrainingSettings(hidden=(16, 16), baseline_degree=3, iterations=100)
    return train(turned_samples(IRREGULAR), settings)


@pytest.fixture(params=["law", "irregular"])
def any_law(request):
    """A square plant cell's, and one of plant cells without symmetry."""
    return request.getfixturevalue(request.param)


def both_paths(law):
    return (lambda F, F_dot: law.respond(F, F_dot).stress, partial(torch_stress, law))


@pytest.mark.parametrize("group_element", G, ids=range(8))
def test_monomials_change_sign_as_their_parity_says(group_element):
    """T → Gᵀ T G; every tensor is written with the same four letters as the stress."""
    rng = np.random.default_rng(1)
    T = rng.normal(size=(1, 2, 2))
    moved = group_element.T @ T @ group_element
    signs = to_components(moved)[0] / to_components(T)[0]
    U, A = rng.normal(size=(2, 1, 2, 2))
    U = U + np.swapaxes(U, 1, 2)

    def inputs_of(U, A):
        return np.concatenate([to_components(U)[0, :3], to_components(A)[0]])

    before = inputs_of(U, A)
    after = inputs_of(group_element.T @ U @ group_element, group_element.T @ A @ group_element)
    for product in monomials(3):
        factors = list(product)
        ratio = after[factors].prod() / before[factors].prod()
        assert ratio == pytest.approx(signs[parity(product)])


def generated_by(covariants):
    """Monomials up to degree 4 that are covariants times products of invariants."""
    found = set(covariants)
    for _ in range(4):
        found |= {tuple(sorted(each + invariant)) for each in found for invariant in INVARIANTS}
        found = {each for each in found if len(each) <= 4}
    return found


def test_tables_of_invariants_and_covariants_are_complete():
    """Every monomial up to degree 4 is a polynomial in invariants times covariants."""
    assert all(parity(product) == 0 for product in INVARIANTS)
    assert [parity(product) for product in COVARIANTS] == [0] + [1] * 4 + [2] * 4 + [3] * 5
    assert set(monomials(4)) <= generated_by(COVARIANTS)


@pytest.mark.parametrize("angle", [0.3, -1.2, np.pi, 2.5])
def test_a_constant_rotation_turns_the_stress(any_law, points, angle):
    Q = turn(angle)
    for stress in both_paths(any_law):
        assert_near(stress(Q @ points[0], Q @ points[1]), Q @ stress(*points) @ Q.T, 1e-12)


@pytest.mark.parametrize("g", G, ids=range(8))
def test_the_group_of_the_square_cell_changes_nothing(law, points, g):
    Q = np.eye(2) if np.linalg.det(g) > 0.0 else g
    for stress in both_paths(law):
        assert_near(stress(Q @ points[0] @ g, Q @ points[1] @ g), Q @ stress(*points) @ Q, 1e-12)


def test_no_stress_at_rest(any_law):
    for Q in ROTATIONS:
        for stress in both_paths(any_law):
            assert not stress(Q[None], np.zeros((1, 2, 2))).any()


@pytest.mark.parametrize("rate", [0.0, 0.006])
@pytest.mark.parametrize("direction", [np.diag([1.0, -1.0]), np.array([[0.0, 1.0], [1.0, 0.0]])])
@pytest.mark.parametrize("centre", [np.eye(2), np.diag([1.03, 1.03]), np.diag([1.02, 0.99])])
def test_smooth_across_the_folds(law, direction, centre, rate):
    """Along a line through U₁₁ = U₂₂ and U₁₂ = 0 the derivative is continuous.

    One-sided second-order differences from left and right agree to O(h²) where the stress is
    smooth and differ by the kink where it is not; the lattice's stress sets the size.
    """
    h = 1e-4
    steps = h * np.array([-2, -1, 0, 1, 2])
    F = centre + steps[:, None, None] * direction
    F_dot = np.broadcast_to(rate * np.array([[0.3, 1.0], [-0.5, 0.2]]), F.shape).copy()
    a, b, c, d, e = law.respond(F, F_dot).stress
    left = (3 * c - 4 * b + a) / (2 * h)
    right = (-3 * c + 4 * d - e) / (2 * h)
    assert np.abs(right - left).max() < 1e-4 * np.abs(left).max()


@pytest.mark.parametrize("symmetry", ["D4", "none"])
@pytest.mark.parametrize("second_order", [True, False])
def test_correction_and_its_slope(symmetry, second_order):
    network = make_network(symmetry)
    network.second_order = second_order
    generator = torch.Generator().manual_seed(6)
    x, direction = torch.randn((2, 20, 7), generator=generator, dtype=torch.float64)
    shapes, moving = along(network.shapes, (x,), (direction,))
    found = network.correction(shapes, moving)
    expected = along(lambda *at: network.correction(Shapes(*at))[0], shapes, moving)
    for part, wanted in zip(found, expected, strict=True):
        torch.testing.assert_close(part, wanted, rtol=1e-12, atol=1e-12)
    assert expected[1].abs().max() > 1e-3


@pytest.mark.parametrize(
    ("arrangement", "symmetry"), [("square", "D4"), ("hexagon", "none"), ("voronoi", "none")]
)
def test_only_the_square_takes_d4_for_granted(arrangement, symmetry):
    cell = CellParameters.preset("printed", arrangement=arrangement, cells=4)
    settings = TrainingSettings(hidden=(4,), baseline_degree=1, iterations=1)
    assert train(lattice_samples(200, cell=cell), settings).network.symmetry == symmetry


def test_learns_what_a_square_cell_could_not(irregular):
    """The same data with D4 taken for granted leaves errors of the order of the stress."""
    worst = max(irregular.errors["rms"].values())
    assert worst < 0.02
    settings = replace(irregular.settings, iterations=20)
    square = train(turned_samples(CELL, 800), settings)
    assert max(square.errors["rms"].values()) > 0.1 > 5.0 * worst

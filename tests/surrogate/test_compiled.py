"""The compiled pass against its torch twin, and its edges."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from surrofe2.base.sampling import sample
from surrofe2.base.simd import TILE, fill_tanh
from surrofe2.base.square_symmetry import parity
from surrofe2.base.tensors import INPUTS, to_inputs
from surrofe2.law.stress_law import Status
from surrofe2.surrogate.features import SYMMETRIES
from surrofe2.surrogate.lookup import MANY, evaluate_slopes
from surrofe2.surrogate.products import (
    BLOCK,
    ONE,
    TILES,
    Polynomials,
    columns,
    evaluate,
    make_room,
    monomials,
)
from tests.laws import RANGE
from tests.numerics import assert_near, turn
from tests.surrogate.twins import differentiate, make_law, make_network, network_stress


def look_up(law, F, F_dot):
    """(stress, status), within the range and whatever the error."""
    return law.lookup(F, F_dot)[:2]


def turned_points(count):
    F, F_dot = sample(RANGE, count, seed=2)
    return turn(0.9) @ F, turn(0.9) @ F_dot


@pytest.mark.parametrize(
    ("hidden", "degree", "symmetry"),
    [((64, 64), 3, "D4"), ((5,), 0, "D4"), ((7, 3, 10), 4, "D4"), ((7, 6), 3, "none")],
)
@pytest.mark.parametrize("count", [1, BLOCK, 2 * BLOCK + 3])
def test_agrees_with_torch(hidden, degree, symmetry, count):
    network = make_network(symmetry, hidden, degree)
    F, F_dot = turned_points(count)
    stress, status = look_up(make_law(network=network), F, F_dot)
    assert not status.any()
    assert_near(stress, network_stress(network, F, F_dot), 1e-12)


@pytest.mark.parametrize("symmetry", SYMMETRIES)
@pytest.mark.parametrize("degree", [0, 3])
def test_slopes_of_every_symmetry_agree_with_torch(symmetry, degree):
    network = make_network(symmetry, (7, 6), degree)
    F, F_dot = turned_points(BLOCK + 3)
    found = evaluate_slopes(F, F_dot, make_law(network=network).arrays)
    expected = differentiate(network, to_inputs(F, F_dot)[0])
    for one, other in zip(found, expected, strict=True):
        assert_near(one, other, 1e-12)


def test_no_points():
    law, none = make_law(), np.empty((0, 2, 2))
    found = *look_up(law, none, none), *evaluate_slopes(none, none, law.arrays)
    assert [each.shape for each in found] == [(0, 2, 2), (0,), (0, 4), (0, 4, 7)]


def test_many_points_on_all_cores_give_the_same():
    law = make_law()
    F, F_dot = turned_points(MANY + 7)
    whole, _ = look_up(law, F, F_dot)
    half = MANY // 2 // BLOCK * BLOCK
    parts = [look_up(law, F[s], F_dot[s])[0] for s in (slice(half), slice(half, None))]
    assert np.array_equal(whole, np.concatenate(parts))


def test_the_bits_of_an_answer_do_not_depend_on_its_place():
    law = make_law()
    F, F_dot = turned_points(4 * BLOCK)
    whole, _ = look_up(law, F, F_dot)
    for k in range(1, BLOCK + 1):
        part, _ = look_up(law, F[k:].copy(), F_dot[k:].copy())
        assert np.array_equal(part, whole[k:], equal_nan=True), k


@pytest.mark.parametrize(("layer", "value"), [(0, np.nan), (1, np.nan), (2, np.nan), (2, np.inf)])
def test_a_weight_that_is_no_number_is_seen(layer, value):
    network = make_network()
    with torch.no_grad():
        network.factors[layer].weight[0, 0] = value
    stress, status = look_up(make_law(network=network), *turned_points(50))
    assert (status == Status.NOT_FINITE).all()
    assert np.isnan(stress).all()


def test_tanh():
    y = np.concatenate([np.linspace(-25, 25, 9001), [0.0, 1e-300, 700.0, -1e30, np.inf, -np.inf]])
    found = y.copy()
    fill_tanh(found)
    assert np.abs(found - np.tanh(y)).max() < 1e-15
    assert found[9001] == 0.0
    y[:3] = np.nan
    fill_tanh(y)
    assert np.isnan(y[:3]).all()
    assert np.isfinite(y[3:]).all()


def test_a_fingerprint_is_of_weights_and_range():
    parameters = make_network().to_parameters()
    again = replace(parameters, tensors=dict(reversed(parameters.tensors.items())))
    assert again.fingerprint(RANGE) == parameters.fingerprint(RANGE)
    assert again.fingerprint(replace(RANGE, rate=0.02)) != parameters.fingerprint(RANGE)
    other = {**parameters.tensors, "factors.1.bias": parameters.tensors["factors.1.bias"] + 1e-12}
    assert replace(parameters, tensors=other).fingerprint(RANGE) != parameters.fingerprint(RANGE)


@pytest.mark.parametrize("inputs", [0, INPUTS])
@pytest.mark.parametrize(("degree", "symmetric"), [(1, True), (4, True), (3, False), (5, True)])
def test_values_and_slopes_are_sums_of_monomials(degree, symmetric, inputs):
    """Slopes by differences along imaginary inputs, which are exact."""
    rng, h = np.random.default_rng(degree), 1e-30
    products = [(), *monomials(degree)]
    each = [
        [(product, rng.normal()) for product in products if not symmetric or parity(product) == k]
        for k in range(4)
    ]
    each[3] = each[3] if symmetric else []
    x = rng.uniform(-1.0, 1.0, (TILES * TILE, INPUTS + 1))
    x[:, ONE] = 1.0

    def values(x):
        zero = 0.0 * x[:, 0]
        return np.array([zero + sum(c * x[:, [*p]].prod(axis=1) for p, c in part) for part in each])

    expected = values(x)
    slopes = np.array([values(x + 1j * h * unit).imag / h for unit in np.eye(INPUTS, INPUTS + 1)])
    kept = [(0, 3, 6), (2,), ()]
    polynomials = Polynomials.of(ONE + 1, each, kept)
    room = make_room(polynomials, ONE + 1, inputs)
    rows, y, row_slopes, y_slopes = room
    rows[: ONE + 1] = x.T.reshape(-1, TILES, TILE)
    rows[ONE + 1 :] = np.nan
    evaluate(polynomials, room)
    assert_near(y.reshape(4, -1), expected, 1e-12)
    found = y_slopes.reshape(inputs, 4, len(x)) - slopes[:inputs]
    assert np.abs(found).max(initial=0.0) < 1e-12 * np.abs(slopes).max()
    read = rows[polynomials.kept].reshape(len(kept), -1)
    assert np.allclose(read, columns(x, kept), rtol=1e-15, atol=0.0)
    for k in range(inputs):
        wanted = x[:, 3] * x[:, 6] if k == 0 else x[:, 0] * x[:, 9 - k] if k in (3, 6) else 0.0 * k
        assert np.allclose(row_slopes[k, polynomials.kept[0]].ravel(), wanted, rtol=1e-15)

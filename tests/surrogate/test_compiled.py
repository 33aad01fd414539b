"""The compiled pass against its torch twin, and its edges."""

import numpy as np
import pytest
import torch

from surrofe2.sampling import contains, sample
from surrofe2.stress_law import Status
from surrofe2.surrogate import TrainingSettings
from surrofe2.surrogate.compiled import BLOCK, MANY, evaluate, without_rest
from surrofe2.surrogate.compiled_slopes import evaluate_slopes
from surrofe2.surrogate.features import FORMS, SYMMETRIES, input_scale
from surrofe2.surrogate.network import StressNetwork
from surrofe2.surrogate.network_slopes import differentiate
from surrofe2.surrogate.packing import pack
from surrofe2.surrogate.piola import to_cauchy
from surrofe2.surrogate.vector_tanh import fill_tanh
from surrofe2.tensors import to_inputs
from tests.laws import RANGE


def make_network(hidden, degree, precision=torch.float64, symmetry="D4", **settings):
    """Random weights, all of which matter."""
    settings = TrainingSettings(hidden=hidden, baseline_degree=degree, seed=3, **settings)
    network = StressNetwork(settings, symmetry)
    generator = torch.Generator().manual_seed(4)
    network.input_scale.copy_(torch.from_numpy(input_scale(RANGE)))
    network.coefficients.normal_(generator=generator)
    network.energy_coefficients.normal_(0.0, 0.05, generator=generator)
    network.output_scale.copy_(torch.tensor([1.0, 2.0, 3.0, 4.0]))
    network.energy_scale.fill_(0.05)
    return network.to(precision)


def make_weights(network):
    return without_rest(pack(network, RANGE), network.features)


def twin(network, F, F_dot):
    with torch.no_grad():
        inputs = torch.as_tensor(to_inputs(F, F_dot)[0], dtype=network.input_scale.dtype)
        return to_cauchy(F, network(inputs).double().numpy())


def turned_points(count):
    F, F_dot = sample(RANGE, count, seed=2)
    Q = np.array([[0.6, -0.8], [0.8, 0.6]])
    return Q @ F, Q @ F_dot


@pytest.mark.parametrize(
    ("hidden", "degree"), [((64, 64), 3), ((5,), 0), ((7, 3, 10), 4), ((16, 16), 1)]
)
@pytest.mark.parametrize("count", [1, BLOCK, 2 * BLOCK + 3])
def test_agrees_with_torch(hidden, degree, count):
    network = make_network(hidden, degree)
    F, F_dot = turned_points(count)
    stress, status = evaluate(F, F_dot, make_weights(network))
    expected = twin(network, F, F_dot)
    assert not status.any()
    assert np.abs(stress - expected).max() < 1e-12 * np.abs(expected).max()


every_form = pytest.mark.parametrize(
    ("form", "symmetry", "members"),
    [(form, symmetry, 1 + k) for k, form in enumerate(FORMS) for symmetry in SYMMETRIES],
)


@every_form
def test_every_form_agrees_with_torch(form, symmetry, members):
    network = make_network(
        (7, 6), 3, symmetry=symmetry, form=form, members=members, energy_hidden=(5, 6)
    )
    F, F_dot = turned_points(BLOCK + 3)
    stress, status = evaluate(F, F_dot, make_weights(network))
    expected = twin(network, F, F_dot)
    assert not status.any()
    assert np.abs(stress - expected).max() < 1e-12 * np.abs(expected).max()


@every_form
def test_slopes_of_every_form_agree_with_torch(form, symmetry, members):
    network = make_network(
        (7, 6), 3, symmetry=symmetry, form=form, members=members, energy_hidden=(5, 6, 3)
    )
    F, F_dot = turned_points(BLOCK + 3)
    found = evaluate_slopes(F, F_dot, make_weights(network))
    expected = differentiate(network, to_inputs(F, F_dot)[0])
    for one, other in zip(found, expected, strict=True):
        assert np.abs(one - other).max() < 1e-12 * np.abs(other).max()


def test_no_points_have_no_slopes():
    weights = make_weights(make_network((4,), 1))
    P, slopes = evaluate_slopes(np.empty((0, 2, 2)), np.empty((0, 2, 2)), weights)
    assert P.shape == (0, 4)
    assert slopes.shape == (0, 4, 7)


def test_many_points_on_all_cores_give_the_same():
    weights = make_weights(make_network((16, 16), 2))
    F, F_dot = turned_points(MANY + 7)
    whole, _ = evaluate(F, F_dot, weights)
    half = MANY // 2 // BLOCK * BLOCK
    parts = [evaluate(F[s], F_dot[s], weights)[0] for s in (slice(half), slice(half, None))]
    assert np.array_equal(whole, np.concatenate(parts))


def test_no_points():
    stress, status = evaluate(
        np.empty((0, 2, 2)), np.empty((0, 2, 2)), make_weights(make_network((4,), 1))
    )
    assert stress.shape == (0, 2, 2)
    assert status.shape == (0,)


def test_float32_is_close_and_not_float64():
    network = make_network((32, 32), 3)
    F, F_dot = turned_points(200)
    exact, _ = evaluate(F, F_dot, make_weights(network))
    network = network.to(torch.float32)
    stress, _ = evaluate(F, F_dot, make_weights(network))
    scale = np.abs(exact).max()
    assert np.abs(stress - twin(network, F, F_dot)).max() < 2e-6 * scale
    assert 1e-9 * scale < np.abs(stress - exact).max() < 2e-6 * scale
    at_rest, _ = evaluate(np.eye(2)[None], np.zeros((1, 2, 2)), make_weights(network))
    assert not at_rest.any()


def test_range_test_is_that_of_the_range():
    weights = make_weights(make_network((4,), 1))
    rng = np.random.default_rng(5)
    F = np.eye(2) + rng.uniform(-0.12, 0.12, (4000, 2, 2))
    F_dot = rng.uniform(-0.012, 0.012, (4000, 2, 2))
    F[:100] *= -1.0
    F[100:200, 0] *= -1.0
    inside = contains(RANGE, F, F_dot)
    assert 100 < inside.sum() < 2000
    stress, status = evaluate(F, F_dot, weights)
    assert np.array_equal(status, np.where(inside, Status.OK, Status.OUT_OF_RANGE))
    assert np.array_equal(np.isfinite(stress).all(axis=(1, 2)), inside)


def test_what_is_not_a_number_is_out_of_range():
    weights = make_weights(make_network((4,), 1))
    for value in (np.nan, np.inf, -np.inf):
        for k in range(8):
            F, F_dot = np.eye(2)[None].copy(), np.zeros((1, 2, 2))
            (F if k < 4 else F_dot).flat[k % 4] = value
            stress, status = evaluate(F, F_dot, weights)
            assert status[0] == Status.OUT_OF_RANGE
            assert np.isnan(stress).all()


@pytest.mark.parametrize(("layer", "value"), [(0, np.nan), (1, np.nan), (2, np.nan), (2, np.inf)])
@pytest.mark.parametrize("precision", [torch.float64, torch.float32])
def test_a_weight_that_is_no_number_is_seen(layer, value, precision):
    network = make_network((8, 8), 2, precision)
    with torch.no_grad():
        network.members[0].factors.layers[layer].weight[0, 0] = value
    stress, status = evaluate(*turned_points(50), make_weights(network))
    assert (status == Status.NOT_FINITE).all()
    assert np.isnan(stress).all()


@pytest.mark.parametrize(("precision", "bound"), [(np.float64, 1e-15), (np.float32, 4e-7)])
def test_tanh(precision, bound):
    y = np.concatenate([np.linspace(-25, 25, 9001), [0.0, 1e-300, 700.0, -1e30, np.inf, -np.inf]])
    with np.errstate(over="ignore", under="ignore"):
        y = y.astype(precision)[None]
    found = y.copy()
    fill_tanh(found)
    assert found.dtype == precision
    assert np.abs(found - np.tanh(y.astype(np.float64))).max() < bound
    assert found[0, 9001] == 0.0
    y[0, :3] = np.nan
    fill_tanh(y)
    assert np.isnan(y[0, :3]).all()
    assert np.isfinite(y[0, 3:]).all()

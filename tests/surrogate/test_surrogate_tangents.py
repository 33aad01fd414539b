"""Tangents and symmetry of a surrogate, whatever its weights."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.sampling import sample
from surrofe2.stress_law import Status
from surrofe2.surrogate import TrainingSettings, train
from surrofe2.surrogate.piola import to_piola, to_slopes, to_tangents
from tests.laws import CELL, RANGE, lattice_samples, lattice_stress
from tests.surrogate.networks import make_law

H = 1e-6


def turned_points(count):
    F, F_dot = sample(RANGE, count, seed=5)
    Q = np.array([[0.6, -0.8], [0.8, 0.6]])
    F = np.eye(2) + 0.99 * (F - np.eye(2))
    return Q @ F, 0.99 * Q @ F_dot


def piola(law, F, F_dot):
    """P = det F σ F⁻ᵀ, (n, 2, 2)."""
    answer = law.respond(F, F_dot)
    assert not answer.status.any()
    return np.linalg.det(F)[:, None, None] * answer.stress @ np.linalg.inv(F).swapaxes(1, 2)


def differences(law, F, F_dot):
    """Central differences of P by F and Ḟ, (n, 2, 2, 2, 2) each."""
    by_F, by_rate = np.empty((2, len(F), 2, 2, 2, 2))
    for c, d in np.ndindex(2, 2):
        step = np.zeros((2, 2))
        step[c, d] = H
        by_F[..., c, d] = (piola(law, F + step, F_dot) - piola(law, F - step, F_dot)) / (2 * H)
        by_rate[..., c, d] = (piola(law, F, F_dot + step) - piola(law, F, F_dot - step)) / (2 * H)
    return by_F, by_rate


every_symmetry = pytest.mark.parametrize("symmetry", ["D4", "none"])


@every_symmetry
def test_tangents_are_the_slopes_of_the_stress(symmetry):
    law = make_law(symmetry)
    F, F_dot = turned_points(10)
    tangents = law.respond(F, F_dot, tangents=True).tangents
    for found, expected in zip(
        (tangents.P_by_F, tangents.P_by_F_dot), differences(law, F, F_dot), strict=True
    ):
        assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()


def test_no_tangents_where_there_is_no_stress():
    F = np.stack([np.eye(2), 1.5 * np.eye(2)])
    answer = make_law().respond(F, np.zeros((2, 2, 2)), tangents=True)
    assert answer.status.tolist() == [Status.OK, Status.OUT_OF_RANGE]
    for tangent in (answer.tangents.P_by_F, answer.tangents.P_by_F_dot):
        assert np.isfinite(tangent[0]).all()
        assert np.isnan(tangent[1]).all()
    assert make_law().respond(F, np.zeros((2, 2, 2))).tangents is None


def test_without_symmetry_only_the_rotation_is_exact():
    law = make_law("none")
    F, F_dot = turned_points(20)
    Q, turn = np.array([[0.8, 0.6], [-0.6, 0.8]]), np.array([[0.0, -1.0], [1.0, 0.0]])
    stress = law.respond(F, F_dot).stress
    scale = np.abs(stress).max()
    assert np.abs(law.respond(Q @ F, Q @ F_dot).stress - Q @ stress @ Q.T).max() < 1e-12 * scale
    assert np.abs(law.respond(F @ turn, F_dot @ turn).stress - stress).max() > 1e-2 * scale


def test_slopes_and_tangents_are_each_others_inverse():
    """Slopes by the inputs, differenced from the lattice's stress, against those of tangents."""
    F, F_dot = turned_points(10)

    def at(F, F_dot):
        P = np.linalg.det(F)[:, None, None] * lattice_stress(F, F_dot)
        return P @ np.linalg.inv(F).swapaxes(1, 2)

    by_F, by_rate = np.empty((2, 10, 2, 2, 2, 2))
    for c, d in np.ndindex(2, 2):
        step = np.zeros((2, 2))
        step[c, d] = H
        by_F[..., c, d] = (at(F + step, F_dot) - at(F - step, F_dot)) / (2 * H)
        by_rate[..., c, d] = (at(F, F_dot + step) - at(F, F_dot - step)) / (2 * H)
    slopes = to_slopes(F, by_F, by_rate)
    tangents = to_tangents(F, F_dot, to_piola(F, lattice_stress(F, F_dot)), slopes)
    assert np.abs(tangents.P_by_F - by_F).max() < 1e-7 * np.abs(by_F).max()
    assert np.abs(tangents.P_by_F_dot - by_rate).max() < 1e-7 * np.abs(by_rate).max()


def test_a_plant_cell_without_symmetry_is_learnt():
    """A lattice turned by 20° has D4 about other axes, not about those of the coordinates."""
    a = np.deg2rad(20.0)
    Q = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    straight = lattice_samples(600)
    turned = replace(straight, stress=lattice_stress(straight.F @ Q, straight.F_dot @ Q))
    settings = TrainingSettings(hidden=(16,), baseline_degree=2, iterations=80)
    errors = []
    for symmetry in ("D4", "none"):
        samples = replace(turned, cell=_Arranged(CELL, symmetry))
        errors.append(max(train(samples, settings).errors["rms"][name] for name in ("xx", "xy")))
    assert errors[1] < 3e-2 < 6e-2 < errors[0]


class _Arranged:
    """A plant cell's parameters with the symmetry of an arrangement."""

    def __init__(self, cell, symmetry):
        self.cell, self.symmetry = cell, symmetry

    def __getattr__(self, name):
        return getattr(self.cell, name)

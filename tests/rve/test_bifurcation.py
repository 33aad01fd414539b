"""Stability of what the RVE answers: every equilibrium is a minimum of the elastic energy.

Checked by forces and Hessian written anew in numpy (`curvature_twin`), over all images.
"""

from functools import cache

import numpy as np
import pytest

from surrofe2.base.simd import pack, unpack
from surrofe2.law.stress_law import Status, describe
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw
from surrofe2.rve.continuation import KICK, ROAM, descend, over_saddle, rises
from surrofe2.rve.rve_state import stored_energy
from tests.numerics import turn
from tests.rve import rves
from tests.rve.curvature_twin import Curvatures
from tests.rve.rves import PRESETS, positions

NEAR = {"printed": 0.1, "water": 0.04}
"""Within so much of I, entry by entry, no solve may fail (docs/theory.md)."""
BEYOND = {
    "printed": np.array([np.diag([1.35, 1.0]), np.diag([1.25, 1.25]), np.diag([1.4, 1.1])]),
    "water": np.array([np.diag([0.92, 1.0]), np.diag([0.94, 0.94]), [[0.93, -0.02], [0.0, 1.0]]]),
}
"""The symmetric equilibrium is unstable there, and there is a stable one."""
LOST = {"printed": [[0.905, 0.486], [0.0, 0.7585]], "water": [[0.905, 0.486], [0.0, 0.7585]]}
"""Nothing stable is found there."""


def law(preset, initialisation="elastic"):
    return rves.law(preset, initialisation)


@cache
def curvatures(preset):
    return Curvatures(law(preset).cell, law(preset).rest_length)


def assert_stable(preset, F, answer, chunk=256):
    """Every answer with a stress is an equilibrium and a minimum; returns the least eigenvalue."""
    solved = np.flatnonzero(answer.status == Status.OK)
    z, least = positions(answer.state), np.inf
    for first in range(0, len(solved), chunk):
        part = solved[first : first + chunk]
        f, stress, hessian = curvatures(preset).at(z[part], F[part])
        assert np.linalg.norm(f, axis=2).mean(axis=1).max() < 1e-7
        np.testing.assert_allclose(answer.stress[part], stress, rtol=0, atol=1e-8)
        least = min(least, np.linalg.eigvalsh(hessian).min())
    assert least > 0.0
    failed = answer.status[answer.status != Status.OK]
    assert np.isin(failed, [Status.UNSTABLE, Status.NOT_CONVERGED]).all()
    assert np.isnan(answer.stress[answer.status != Status.OK]).all()
    return least


def near(preset, count, seed=0):
    rng = np.random.default_rng(seed)
    F, F_dot = rng.uniform(-1.0, 1.0, (2, count, 2, 2))
    F[: count // 10] = np.sign(F[: count // 10])
    return np.eye(2) + NEAR[preset] * F, NEAR[preset] * F_dot


def far(count, seed=0):
    """Stretches 1/1.5 to 1.5 and shears up to 0.6, the rotation at random."""
    rng = np.random.default_rng(seed)
    F = np.zeros((count, 2, 2))
    F[:, [0, 1], [0, 1]] = np.exp(rng.uniform(-1.0, 1.0, (count, 2)) * np.log(1.5))
    F[:, 0, 1] = rng.uniform(-0.6, 0.6, count)
    return turn(rng.uniform(-np.pi, np.pi, count)) @ F


@pytest.mark.parametrize("preset", PRESETS)
def test_hessian_of_the_twin_is_the_slope_of_its_forces(preset):
    F = BEYOND[preset][2:]
    z = positions(law(preset).respond(F, np.zeros_like(F)).state)
    f, _, hessian = curvatures(preset).at(z, F)
    expected = curvatures(preset).evaluate(z[0], F[0], 0.0 * F[0])[0]
    np.testing.assert_allclose(f[0], expected, rtol=0, atol=1e-9)
    rng, h = np.random.default_rng(1), 1e-5
    step = rng.normal(size=z.shape[1:])
    step[0] = 0.0
    moved = [curvatures(preset).at(z + s * h * step @ np.linalg.inv(F[0]).T, F)[0] for s in (-1, 1)]
    slope = (moved[0] - moved[1])[0, 1:].ravel() / (2 * h)
    np.testing.assert_allclose(hessian[0] @ step[1:].ravel(), slope, rtol=1e-6, atol=1e-2)


@pytest.mark.parametrize("preset", PRESETS)
def test_beyond_a_bifurcation_the_answer_is_stable_and_says_that_it_left(preset):
    F = np.concatenate([np.eye(2)[None], BEYOND[preset]])
    answer = law(preset).respond(F, np.zeros_like(F))
    assert (answer.status == Status.OK).all()
    assert answer.left_bifurcation.tolist() == [False, True, True, True]
    assert answer.effort["left_bifurcation"] == 3
    assert_stable(preset, F, answer)


@pytest.mark.parametrize("preset", PRESETS)
def test_where_no_stable_state_is_found_there_is_no_stress(preset):
    F = np.array([np.eye(2), LOST[preset]])
    answer = law(preset).respond(F, np.zeros_like(F))
    assert answer.status.tolist() == [Status.OK, Status.UNSTABLE]
    assert "unstable" in describe(answer.status[1])
    assert np.isnan(answer.stress[1]).all()


@pytest.mark.parametrize(
    "initialisation",
    ["elastic", "constrained-runs", pytest.param("slow-manifold", marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("count", [400, pytest.param(10_000, marks=pytest.mark.nightly)])
def test_no_solve_fails_near_the_reference(initialisation, count):
    for preset in PRESETS:
        F, F_dot = near(preset, count, seed=1)
        assert not law(preset, initialisation).respond(F, F_dot).status.any()


def test_no_other_initialisation_is_less_stable():
    """Dashpots move particles, not the branch they are on."""
    F = np.concatenate([BEYOND["printed"], np.eye(2)[None]])
    F_dot = 0.001 * np.random.default_rng(3).uniform(-1.0, 1.0, F.shape)
    elastic = law("printed").respond(F, F_dot)
    for name in ("constrained-runs", "slow-manifold"):
        answer = law("printed", name).respond(F, F_dot)
        assert not answer.status.any()
        np.testing.assert_array_equal(answer.left_bifurcation, elastic.left_bifurcation)
        assert abs(positions(answer.state) - positions(elastic.state)).max() < 0.1


def test_a_rotation_turns_the_branch_along():
    """Which of the branches is reached is chosen in material coordinates."""
    F, Q = BEYOND["printed"], turn(0.7)
    one, other = (law("printed").respond(G, np.zeros_like(F)) for G in (F, Q @ F))
    np.testing.assert_allclose(other.stress, Q @ one.stress @ Q.T, rtol=0, atol=1e-7)


def test_the_way_down_only_goes_down():
    this, F = law("printed"), BEYOND["printed"]
    unit = this.unit_cell
    start = np.repeat(unit.position.T[None], len(F), axis=0)
    end, found, _ = descend(unit, F, start)
    assert found.all()
    there, before = (stored_energy(F, z, unit.topology, unit.constants) for z in (end, start))
    assert (there < before).all()
    assert (np.abs(end - start).max(axis=(1, 2)) > ROAM).any()  # contacts were listed again


def test_contacts_left_out_change_no_bit():
    """A list covers what it was made for, until particles have moved by half the skin."""
    unit, F = law("printed").unit_cell, far(5)
    rest = unit.position.T + 0 * F[:, :1, :1]
    near = unit.neighbours.near(pack(F), pack(rest), 2.0)
    rng = np.random.default_rng(2)
    z = rest + 0.5 * rng.uniform(-1.0, 1.0, rest.shape) / 1.6
    assert near.covers(pack(F), pack(z)).all()
    assert not near.covers(pack(F), pack(rest + 2.0 * (np.arange(35) == 7))).any()
    assert len(near.topology.contacts) < 0.5 * len(unit.topology.contacts)
    energies = [
        stored_energy(F, z, each, unit.constants) for each in (near.topology, unit.topology)
    ]
    np.testing.assert_array_equal(*energies)


def test_contacts_are_looked_at_one_by_one_where_the_bound_is_too_coarse():
    """Against distances by numpy."""
    unit, F, rng = law("printed").unit_cell, far(40), np.random.default_rng(2)
    rest, every = unit.position.T, unit.topology
    z = rest + rng.uniform(0.0, 3.0, (40, 1, 1)) * rng.uniform(-1.0, 1.0, (40, 2, 35))
    near = unit.neighbours.near(pack(F), pack(rest + 0 * z), 0.5)
    i, j = near.every.contacts[~near.listed].T
    local = np.concatenate([z, z[:, :, every.owner] + every.image_offset.T], axis=2)
    r = np.einsum("nab,nbk->nak", F, local[:, :, j] - local[:, :, i])
    apart = (np.linalg.norm(r, axis=1) >= near.cutoff).all(axis=1)
    bound, exact = (unpack(near.covers(pack(F), pack(z), exactly=e), 40) for e in (False, True))
    np.testing.assert_array_equal(exact, apart)
    assert not (bound & ~apart).any()
    assert (apart & ~bound).any()
    assert not apart.all()


@pytest.mark.parametrize("below", [[-2.0, -1.0], [-1.0], [-1.0, -1.0]])
def test_steps_over_a_saddle_go_down_unstable_modes(below):
    """By (A15); at rest along the softest alone, whatever their eigenvectors' signs."""
    rng = np.random.default_rng(1)
    values = np.array([*below, *range(1, 21 - len(below))])
    modes, _ = np.linalg.qr(rng.normal(size=(len(values), len(values))))
    matrix, forces = (modes * values) @ modes.T, rng.normal(size=len(values))
    step = over_saddle(np.eye(2), forces, matrix, resting=False)
    expected = modes @ ((modes.T @ forces) / np.abs(values))
    np.testing.assert_allclose(step, expected, rtol=0, atol=1e-10)
    kick = over_saddle(np.eye(2), 0.0 * forces, matrix, resting=True)
    others = modes[:, below.count(below[0]) :]
    np.testing.assert_allclose(others.T @ kick, 0.0, atol=1e-12)
    lengths = np.linalg.norm(kick.reshape(-1, 2), axis=1)
    assert lengths.max() == pytest.approx(KICK, rel=1e-12)


def test_a_hessian_that_is_singular_by_rounding_alone_is_no_saddle(monkeypatch):
    """Without an unstable mode there is no kick, and the way down has come to its end."""
    singular = np.diag(np.arange(20.0))
    np.testing.assert_array_equal(over_saddle(np.eye(2), np.zeros(20), singular, resting=True), 0.0)
    unit = law("printed").unit_cell
    rest = unit.position.T[None]
    monkeypatch.setattr("scipy.linalg.lapack.dpotrf", lambda matrix, clean: (matrix, 1))
    z, found, _ = descend(unit, np.eye(2)[None], rest)
    assert found.all()
    np.testing.assert_array_equal(z, rest)


def test_a_kick_goes_to_the_lower_side_and_knows_sides_that_are_images():
    """A step that the point reflection of the square cell turns around has sides of one energy."""
    unit, rng = law("printed").unit_cell, np.random.default_rng(4)
    rest = np.eye(2), unit.position.T
    step = 0.2 * rng.normal(size=(unit.topology.particles - 1, 2))
    higher = [rises(*rest, sign * step.ravel(), unit.topology, unit.constants) for sign in (1, -1)]
    sides = unit.position[1:] + step, unit.position[1:] - step
    z = np.array([np.vstack([[0.0, 0.0], side]).T for side in sides])
    F = np.broadcast_to(np.eye(2), (2, 2, 2))
    energy = stored_energy(F, z, unit.topology, unit.constants)
    assert higher == [energy[0] > energy[1], energy[1] > energy[0]]
    apart = unit.position[1:] + unit.position[1:, None]
    apart -= 25.0 * np.rint(apart / 25.0)
    partner = np.argmin((apart**2).sum(axis=2), axis=0)
    odd = (step + step[partner]).ravel()
    for sign in (1, -1):
        assert not rises(*rest, sign * odd, unit.topology, unit.constants)


def test_far_points_alone_have_the_bits_of_a_batch():
    """However many halved steps a tile tries at once, and whatever contacts others have."""
    F = far(20, seed=3)
    F_dot = np.zeros_like(F)
    together = law("water").respond(F, F_dot)
    assert together.left_bifurcation.sum() >= 5
    assert 0 < np.count_nonzero(together.status) < 15
    for k in range(len(F)):
        alone = law("water").respond(F[k : k + 1], F_dot[k : k + 1])
        assert alone.status[0] == together.status[k]
        np.testing.assert_array_equal(alone.stress[0], together.stress[k])


@pytest.mark.parametrize("initialisation", ["elastic", "constrained-runs", "slow-manifold"])
def test_a_warm_run_leaves_at_an_accepted_step(initialisation):
    """Stretched in small warm steps; where no trial has to factorise, accept has to look."""
    this, state, left_at = law("printed", initialisation), None, []
    for stretch in np.linspace(1.0, 1.3, 61):
        F = np.array([np.diag([stretch, 1.0])])
        F_dot = 1e-3 * np.diag([1.0, 0.0])[None]
        answer = this.respond(F, F_dot, state)
        accepted = this.accept(F, F_dot, answer)
        assert answer.status[0] == accepted.status[0] == Status.OK
        state = accepted.state
        if accepted.left_bifurcation is not None:
            left_at.append(stretch)
            assert abs(accepted.stress - answer.stress).max() > 1e-6
            again = this.respond(F, F_dot, state)
            np.testing.assert_allclose(again.stress, accepted.stress, rtol=0, atol=1e-7)
        else:
            assert accepted.stress is answer.stress
            left_at += [stretch] * answer.effort["left_bifurcation"]
        assert state.left_points.all() == bool(left_at)
    assert len(left_at) == 1
    assert 1.15 < left_at[0] < 1.2
    rest = this.respond(F, 0.0 * F, state)
    assert_stable("printed", F, rest)


def test_states_carry_where_they_left_with_them():
    F = np.concatenate([np.repeat(np.eye(2)[None], 9, axis=0), BEYOND["printed"]])
    state = law("printed").respond(F, np.zeros_like(F)).state
    part = state.take(np.array([11, 0, 10]))
    assert part.left_points.tolist() == [True, False, True]
    rest = law("printed").rest_state(12)
    assert not rest.has_left.any()
    assert rest.put(np.array([2, 3, 4]), part).left_points.nonzero()[0].tolist() == [2, 4]
    assert not rest.put(np.array([2]), rest.take(np.array([5]))).has_left.any()


@pytest.mark.nightly
@pytest.mark.parametrize("preset", PRESETS)
def test_10000_equilibria_near_the_reference_are_minima(preset):
    F, _ = near(preset, 10_000, seed=1)
    answer = law(preset).respond(F, np.zeros_like(F))
    assert_stable(preset, F, answer)


@pytest.mark.nightly
@pytest.mark.parametrize("preset", PRESETS)
def test_far_answers_are_minima_or_failures(preset):
    """Beyond, out to stretch 1.5 and shear 0.6."""
    F = far(1000)
    answer = law(preset).respond(F, np.zeros_like(F))
    assert_stable(preset, F, answer)
    assert (answer.status == Status.OK).mean() > {"printed": 0.75, "water": 0.55}[preset]


def test_rotated_and_mirrored_hexagons_take_the_rotated_and_mirrored_branch():
    """Of `water`, where a quarter of all states at 4 % leave theirs; turns of the hexagon, too."""
    cell = CellParameters.preset("water", arrangement="hexagon", fluid="sph")
    this = RveLaw(cell, initialisation="elastic")
    Q, M, G = turn(0.7), np.diag([-1.0, 1.0]), turn(np.pi / 3.0)
    F = np.eye(2) + 0.04 * np.random.default_rng(5).uniform(-1.0, 1.0, (24, 2, 2))
    F = F[this.respond(F, 0.0 * F).state.left_points]
    assert len(F) >= 4
    answer = this.respond(F, 0.0 * F)
    for copies, back in ((Q @ F, Q.T), (M @ F @ M, M), (F @ G, np.eye(2))):
        other = this.respond(copies, 0.0 * F)
        np.testing.assert_array_equal(other.status, answer.status)
        assert other.left_bifurcation.all()
        np.testing.assert_allclose(back @ other.stress @ back.T, answer.stress, rtol=0, atol=1e-8)

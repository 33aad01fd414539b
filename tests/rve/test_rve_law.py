"""What must hold of the RVE's stress: fixed points, symmetries, energy, failures, kept factors."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.base.simd import TILE, unpack
from surrofe2.law.stress_law import Status
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import INITIALISATIONS, RveLaw, RveSettings
from tests.numerics import assert_near, differences, turn
from tests.plant_cell.twin import Twin
from tests.rve.rves import PRESETS, assert_balanced, deformations, law, piola, positions


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("initialisation", ["constrained-runs", "elastic"])
def test_direct_solve_rests_at_the_fixed_point_over_all_images(preset, initialisation):
    """Forces and stress by brute force over all images: no pair within a cut-off is missed."""
    F, F_dot = deformations(preset)
    answer = law(preset, initialisation).respond(F, F_dot)
    assert (answer.status == Status.OK).all()
    felt = 0.0 * F_dot if initialisation == "elastic" else F_dot
    assert_balanced(law(preset), answer, F, F_dot, range(12), felt)


@pytest.mark.parametrize("preset", PRESETS)
def test_direct_agrees_with_the_papers_iteration(preset):
    F, F_dot = deformations(preset, n=4)
    direct = law(preset).respond(F, F_dot)
    iterated = law(preset, solver="iterated", stop=1e-8).respond(F, F_dot)
    assert (iterated.status == Status.OK).all()
    np.testing.assert_allclose(iterated.stress, direct.stress, rtol=0, atol=1e-6)
    assert iterated.effort["force_evaluations"] > 1000 * direct.effort["force_evaluations"]


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("initialisation", INITIALISATIONS)
def test_symmetries(preset, initialisation):
    F, F_dot = deformations(preset)
    this = law(preset, initialisation)
    stress = this.respond(F, F_dot).stress
    Q = turn(0.7)
    turned = this.respond(Q @ F, Q @ F_dot).stress
    np.testing.assert_allclose(turned, Q @ stress @ Q.T, rtol=0, atol=1e-9)
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    for G in (quarter, quarter @ quarter, quarter.T):
        np.testing.assert_allclose(this.respond(F @ G, F_dot @ G).stress, stress, rtol=0, atol=1e-9)
    mirror = np.diag([1.0, -1.0])
    for M in (mirror, -mirror, mirror @ quarter, quarter @ mirror):
        there = this.respond(M @ F @ M, M @ F_dot @ M).stress
        np.testing.assert_allclose(there, M @ stress @ M, rtol=0, atol=1e-9)


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("initialisation", ["constrained-runs", "slow-manifold"])
def test_answer_does_not_depend_on_the_warm_start(preset, initialisation):
    this, (F, F_dot) = law(preset, initialisation), deformations(preset)
    cold = this.respond(F, F_dot)
    other = this.respond(*deformations(preset, seed=9)).state
    near = this.respond(F * 1.002, F_dot * 0.9).state
    mixed = near.put(np.array([3, 17]), this.rest_state(2))
    other, near, mixed = (this.respond(F, F_dot, start) for start in (other, near, mixed))
    for warm in (other, near, mixed):
        assert (warm.status == Status.OK).all()
        np.testing.assert_allclose(warm.stress, cold.stress, rtol=0, atol=1e-8)
    assert near.effort["newton_solves"] == 0
    assert mixed.effort["newton_solves"] in ((1, 2) if preset == "printed" else (0, 1, 2))


def test_respond_is_pure():
    F, F_dot = deformations("printed", n=11)
    start = law("printed").respond(F, F_dot)
    kept = {k: getattr(start.state, k).copy() for k in ("z", "F", "iterations")}
    blocks = [block.copy() for block in start.state.factors.blocks]
    far = law("printed").respond(F + 0.03, F_dot, start.state)
    again = law("printed").respond(F + 0.03, F_dot, start.state)
    np.testing.assert_array_equal(far.stress, again.stress)
    assert far.effort["newton_solves"] > 0
    for name, value in kept.items():
        np.testing.assert_array_equal(getattr(start.state, name), value)
    np.testing.assert_array_equal(start.state.factors.blocks, blocks)


def test_a_point_does_not_feel_its_neighbours_in_the_batch():
    F, F_dot = deformations("printed", n=21)
    F[::2] = np.eye(2) + 0.1 * (F[::2] - np.eye(2))  # solved by the reference's own factors
    near = abs(F - np.eye(2)).max(axis=(1, 2)) <= 0.01
    assert 8 <= near.sum() <= 13
    together = law("printed").respond(F, F_dot).stress
    alone = np.concatenate(
        [law("printed").respond(F[i : i + 1], F_dot[i : i + 1]).stress for i in range(21)]
    )
    np.testing.assert_allclose(alone, together, rtol=0, atol=1e-10)


@pytest.mark.parametrize("preset", PRESETS)
def test_elastic_stress_is_the_slope_of_the_relaxed_energy(preset):
    """P = ∂W/∂F, with W the elastic energy per reference area at equilibrium."""
    this = law(preset, "elastic")
    twin = Twin(this.cell, this.rest_length)
    F = deformations(preset, n=3)[0]
    still = np.zeros((2, 2))

    def energy(F):
        answer = this.respond(F[None], still[None])
        return twin.evaluate(positions(answer.state)[0], F, still)[1] / 625.0

    for point in range(3):
        P = piola(this, F[point][None], still[None])[0]
        assert_near(differences(energy, F[point], 1e-5), P, 2e-6)


def test_cauchy_born_is_the_affine_state_and_stiffer():
    """Relaxation lowers the stored energy, so the affine shear stress is the larger."""
    F = np.array([[[1.0, 0.1], [0.0, 1.0]]])
    still = np.zeros_like(F)
    this = law("printed", "cauchy-born")
    stress = this.respond(F, still).stress[0]
    twin = Twin(this.cell, this.rest_length)
    _, _, expected = twin.evaluate(this.unit_cell.position, F[0], still[0])
    np.testing.assert_allclose(stress, expected, rtol=0, atol=1e-9)
    assert stress[0, 1] > 1.02 * law("printed", "elastic").respond(F, still).stress[0, 0, 1] > 0


@pytest.mark.parametrize("initialisation", ["constrained-runs", "slow-manifold"])
def test_at_rest_stress_is_that_of_the_elastic_equilibrium(initialisation):
    F = deformations("water")[0]
    found, wanted = (law("water", each).respond(F, 0.0 * F) for each in (initialisation, "elastic"))
    np.testing.assert_allclose(found.stress, wanted.stress, rtol=0, atol=1e-8)


def test_shear_of_the_papers_figure_5_range_is_covered():
    """F₁₂ up to 0.2: beyond the shortest contact list, which must notice and give way."""
    F = np.eye(2) + np.array([[[0.0, a], [0.0, 0.0]] for a in (0.1, 0.2, 0.4)])
    answer = law("printed").respond(F, 0.0 * F)
    assert_balanced(law("printed"), answer, F, 0.0 * F, range(3))


def test_iteration_that_meets_its_limit_is_reported():
    F, F_dot = deformations("printed", n=2)
    this = law("printed", solver="iterated", stop=1e-8, max_iterations=50)
    answer = this.respond(F, F_dot)
    assert (answer.status == Status.NOT_CONVERGED).all()
    assert np.isnan(answer.stress).all()


def test_iterated_needs_the_number_of_steps_that_the_paper_reports():
    """Section 6.1: from F = I to F₁₀ a few thousand steps, an increment of 0.01 hundreds."""
    this = law("printed", solver="iterated")
    shear = lambda a: np.array([[[1.0, a], [0.0, 1.0]]])  # noqa: E731
    rate = np.array([[[0.0, 0.01], [0.0, 0.0]]])
    far = this.respond(shear(0.1), rate)
    near = this.respond(shear(0.11), rate, far.state)
    assert 1000 < far.effort["force_evaluations"] < 10000
    assert 50 < near.effort["force_evaluations"] < 1000


def test_states_of_single_points_can_be_taken_and_put_back():
    F, F_dot = deformations("printed", n=21)
    answer = law("printed").respond(F, F_dot)
    index = np.array([3, 20, 8])
    part = law("printed").respond(F[index] * 1.001, F_dot[index], answer.state.take(index))
    assert part.effort["newton_solves"] == 0
    whole = answer.state.put(index, part.state)
    np.testing.assert_array_equal(positions(whole)[20], positions(part.state)[1])
    np.testing.assert_array_equal(positions(whole)[4], positions(answer.state)[4])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"initialisation": "magic"}, "rve.initialisation: 'magic'; it must be one of"),
        ({"solver": "guess"}, "rve.solver: 'guess'; it must be one of direct, iterated"),
        (
            {"initialisation": "slow-manifold", "solver": "iterated"},
            "with initialisation slow-manifold it must be direct",
        ),
        ({"settings": "elastic"}, "rve: 'elastic'; settings must be an RveSettings"),
        ({"cell": {"preset": "apple"}}, "cell: {'preset': 'apple'}; it must be CellParameters"),
        ({"cell": "pear"}, "cell.preset: 'pear'; it must be one of printed, "),
    ],
)
def test_bad_settings_are_named(settings, message):
    with pytest.raises(InputError, match=message):
        RveLaw(**{"cell": CellParameters.preset("printed"), **settings})


def test_cold_answers_are_checked_and_warm_ones_at_accept():
    at, index = deformations("water", 4), np.array([1])
    cold = law("water").respond(*at)
    assert cold.state.is_checked
    assert law("water").accept(*at, cold).state is cold.state
    squeezed = np.tile(0.93 * np.eye(2), (4, 1, 1))  # buckles: docs/theory.md, stability
    beyond = law("water").respond(squeezed, np.zeros_like(squeezed))
    assert (beyond.left_bifurcation | (beyond.status != 0)).all()
    warm = law("water").respond(*at, cold.state)
    assert not warm.state.is_checked
    assert law("water").accept(*at, warm).state is not warm.state
    assert not cold.state.put(index, warm.state.take(index)).is_checked


CORNERS = np.array([[0.0, 25.0, 0.0], [0.0, 0.0, 25.0]])  # X₁, X₂, X₃ as columns


def step_of_the_paper(twin, masses, F, F_dot, x, v, dt):
    """One constrained-runs iteration; corners 2 and 3 are images of corner 1, particle 0."""
    z = np.linalg.solve(F, x.T).T
    forces, *_ = twin.evaluate(z, F, F_dot, v - z @ F_dot.T)
    x_hat, v_hat = x + dt * v, v + dt * forces / masses[:, None]  # (69)
    lattice, drift = F @ CORNERS, F_dot @ CORNERS
    x_corner = x_hat[0][:, None] + lattice + dt * drift
    v_corner = v_hat[0][:, None] + drift
    spanned = (x_corner - x_corner[:, :1])[:, 1:]
    P = lattice[:, 1:] @ np.linalg.inv(spanned)  # (70)
    Q = (drift[:, 1:] - (v_corner - v_corner[:, :1])[:, 1:]) @ np.linalg.inv(spanned)  # (71)
    shifted = x_hat - x_hat[0]
    return shifted @ P.T, shifted @ Q.T + v_hat - v_hat[0]  # (72)


@pytest.mark.parametrize("preset", ["printed", "water"])
def test_a_few_steps_are_those_of_the_paper(preset):
    cell = CellParameters.preset(preset)
    steps, dt = 20, 1e-4
    law = RveLaw(cell, RveSettings(solver="iterated", stop=1e-12, max_iterations=steps))
    F = np.eye(2) + np.array([[0.03, 0.05], [-0.02, -0.04]])
    F_dot = np.array([[0.004, 0.01], [-0.006, 0.003]])
    state = law.respond(F[None], F_dot[None]).state
    twin = Twin(cell, law.rest_length)
    masses = np.where(np.arange(35) < 19, cell.wall_particle_mass, cell.fluid_particle_mass)
    x, v = law.unit_cell.position @ F.T, law.unit_cell.position @ F_dot.T
    for _ in range(steps):
        x, v = step_of_the_paper(twin, masses, F, F_dot, x, v, dt)
    z = state.z[0, :, :, 0].T
    np.testing.assert_allclose(z @ F.T, x, rtol=0, atol=1e-10)
    beyond = state.fluctuation[0, :, :, 0].T
    assert np.abs(beyond).max() > 1e-4
    np.testing.assert_allclose(z @ F_dot.T + beyond, v, rtol=0, atol=1e-10)


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("initialisation", ["constrained-runs", "slow-manifold"])
def test_an_old_state_answers_to_the_bit_as_it_did_before_accept_renewed_tiles(
    preset, initialisation
):
    """Two of three tiles move so far that their factors tire; the third keeps its block."""
    this = law(preset, initialisation)
    F, F_dot = deformations(preset, n=3 * TILE, corners=False)
    F = np.eye(2) + 0.3 * (F - np.eye(2))
    old = this.respond(F, F_dot).state
    moved = F.copy()
    moved[: 2 * TILE] += {"printed": 0.1, "water": 0.3}[preset] * (F[: 2 * TILE] - np.eye(2))[::-1]
    answer = this.respond(moved, F_dot, old)
    assert (answer.status == Status.OK).all()
    assert answer.effort["newton_solves"] == 0
    new = this.accept(moved, F_dot, answer).state
    shared = [a is b for a, b in zip(new.factors.blocks, old.factors.blocks, strict=True)]
    assert shared == [False, False, True]
    later = this.respond(moved * 1.001, F_dot, new)
    assert (this.accept(moved * 1.001, F_dot, later).status == Status.OK).all()
    for state in (old, answer.state):
        first = this.respond(moved, F_dot, state)
        again = this.respond(moved, F_dot, state)
        np.testing.assert_array_equal(first.stress, again.stress)
    np.testing.assert_array_equal(this.respond(moved, F_dot, old).stress, answer.stress)
    # what was renewed serves better: fewer force evaluations from the same place
    stale = this.respond(moved * 1.001, F_dot, answer.state)
    assert later.effort["force_evaluations"] < stale.effort["force_evaluations"]
    np.testing.assert_allclose(later.stress, stale.stress, rtol=0, atol=1e-8)


@pytest.mark.parametrize("initialisation", ["constrained-runs", "slow-manifold", "elastic"])
@pytest.mark.parametrize("shape", [{}, {"arrangement": "hexagon"}])
def test_a_stored_state_answers_to_the_bit(initialisation, shape):
    """Its factors, made at several times at points of one tile, are made again of 2 kB a point."""
    cell = replace(CellParameters.preset("printed"), **shape)
    this = RveLaw(cell, initialisation=initialisation)
    F, F_dot = deformations("printed", 19)
    near_rest = 0.5 * (F + np.eye(2))
    old = this.respond(near_rest, F_dot).state
    answer = this.respond(F, F_dot, old)
    new = this.accept(F, F_dot, answer).state  # has renewed the factors of all tiles
    some = np.arange(1, 19, 3)
    state = new.put(some, old.take(some))
    arrays = this.state_to_arrays(state)
    assert {len(each) for each in arrays.values()} == {19}
    assert sum(each.nbytes for each in arrays.values()) < 0.2 * state.factors.nbytes
    order = np.random.default_rng(3).permutation(19)
    again = this.state_from_arrays(arrays)
    elsewhere = this.state_from_arrays({name: each[order] for name, each in arrays.items()})
    made, made_elsewhere, wanted = (
        unpack(np.stack(each.factors.blocks), 19) for each in (again, elsewhere, state)
    )
    np.testing.assert_array_equal(made, wanted)
    np.testing.assert_array_equal(made_elsewhere, wanted[order])
    np.testing.assert_array_equal(again.near.listed, state.near.listed)
    for share in (0.99, 0.9, 0.2):
        there = np.eye(2) + share * (F - np.eye(2))
        first, second = (this.respond(there, share * F_dot, each) for each in (state, again))
        np.testing.assert_array_equal(second.stress, first.stress)
        assert second.effort == first.effort
        state, again = (this.accept(there, F_dot, each).state for each in (first, second))


def test_a_stored_state_whose_contacts_are_not_listed_lists_them_where_it_would_have():
    this = law("printed")
    F, F_dot = deformations("printed", 11)
    far = this.respond(F, F_dot).state
    state = far.put(np.array([2]), this.respond(F * 1.2, F_dot).state.take(np.array([2])))
    assert state.near is None
    again = this.state_from_arrays(this.state_to_arrays(state))
    assert again.near is None
    first, second = (this.respond(1.01 * F, F_dot, each) for each in (state, again))
    np.testing.assert_array_equal(second.stress, first.stress)
    assert second.effort == first.effort

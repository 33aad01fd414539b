"""Kept factorisations: which state owns what, and that a state never changes once it is given."""

import numpy as np
import pytest

from surrofe2.base.simd import TILE
from surrofe2.law.stress_law import Status
from tests.rve.rves import PRESETS, deformations, law


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


@pytest.mark.parametrize("initialisation", ["constrained-runs", "slow-manifold"])
def test_a_stored_state_has_no_factors_and_answers_within_the_tolerance(initialisation):
    """They are made again where the state is, as the law would renew them there."""
    this = law("printed", initialisation)
    F, F_dot = deformations("printed", 19)
    state = this.respond(0.5 * (F + np.eye(2)), F_dot).state
    arrays = state.to_arrays()
    assert {len(each) for each in arrays.values()} == {19}
    assert sum(each.nbytes for each in arrays.values()) < 0.1 * state.factors.nbytes
    again = this.state_from_arrays(arrays)
    assert len({id(block) for block in again.factors.blocks}) == 3
    found, wanted = this.respond(F, F_dot, again), this.respond(F, F_dot, state)
    spread = abs(wanted.stress).max()
    assert abs(found.stress - wanted.stress).max() < 1e-6 * spread
    assert found.effort["force_evaluations"] < 1.2 * wanted.effort["force_evaluations"]

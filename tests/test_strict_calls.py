"""What laws refuse; points answer alike however many there are, by any number of threads."""

from itertools import product

import numba
import numpy as np
import pytest

from surrofe2 import CellParameters, RveLaw
from surrofe2.base.errors import InputError
from surrofe2.law.regional_law import RegionalLaw
from surrofe2.rve.continuation import EFFORT
from surrofe2.rve.rve_state import RveState
from tests.laws import SoftLaw

EYE, STILL = np.tile(np.eye(2), (3, 1, 1)), np.zeros((3, 2, 2))


@pytest.fixture(scope="module")
def laws():
    """Laws by true RVEs, of two presets and two initialisations."""
    kinds = product(("printed", "water"), ("constrained-runs", "slow-manifold"))
    return {
        (cell, way): RveLaw(CellParameters.preset(cell), initialisation=way) for cell, way in kinds
    }


@pytest.mark.parametrize(
    ("F", "told"),
    [
        (EYE + 0.0j, "F: complex128; it must be an array"),
        (np.ma.masked_array(EYE, EYE > 0.5), "F: a masked array"),
        (EYE > 0.5, "F: bool; it must be an array"),
        ([[[1.0, 0.0], [0.0]]], "F: object; it must be an array"),
        (np.eye(2), "F: shape"),
        (-EYE, None),
        (np.nan * EYE, "F: not finite at point 0"),
        (EYE * [[[1.0], [-1.0]]], "F: det F = -1 at point 0; it must be positive"),
    ],
)
def test_what_are_no_deformations(laws, F, told):
    law = laws["printed", "constrained-runs"]
    if told is None:
        assert not law.respond(F, STILL).status.any()  # turned by 180 degrees
        return
    with pytest.raises(InputError) as caught:
        law.respond(F, STILL)
    assert str(caught.value).startswith(told)
    for F_dot in (STILL + 0.0j, STILL[:2], STILL + np.inf):
        with pytest.raises(InputError, match="F_dot"):
            law.respond(EYE, F_dot)


def test_whole_numbers_and_lists_are_deformations(laws):
    law = laws["printed", "constrained-runs"]
    known = law.respond(EYE, STILL).stress
    for F in (EYE.astype(int), EYE.astype(np.float32), EYE.tolist()):
        np.testing.assert_array_equal(law.respond(F, STILL).stress, known)


@pytest.mark.parametrize(
    "other",
    [("water", "constrained-runs"), ("printed", "slow-manifold"), ("water", "slow-manifold")],
)
def test_the_state_of_another_law_is_refused(laws, other):
    mine = laws["printed", "constrained-runs"]
    foreign = laws[other].respond(EYE, STILL).state
    for state in (foreign, "state", mine.respond(EYE[:2], STILL[:2]).state):
        with pytest.raises(InputError, match="state: not a state of this RveLaw for 3 points"):
            mine.respond(EYE, STILL, state)


def test_a_state_kept_as_arrays_is_the_laws_own_again(laws):
    law = laws["printed", "slow-manifold"]
    state = law.respond(1.01 * EYE, STILL).state
    assert isinstance(state, RveState)
    again = law.state_from_arrays(law.state_to_arrays(state))
    here, there = (law.respond(1.02 * EYE, STILL, each).stress for each in (state, again))
    np.testing.assert_array_equal(there, here)


def test_states_of_other_regions_are_refused():
    regions = {"skin": np.array([0, 2]), "flesh": np.array([1])}
    law = RegionalLaw(dict.fromkeys(regions, SoftLaw()), regions)
    for state in ((None,), (None, None, None), "state"):
        with pytest.raises(InputError, match="state: not of a law of these regions"):
            law.respond(EYE, STILL, state)


def test_no_point_is_an_answer_for_none(laws):
    empty = np.empty((0, 2, 2))
    for law in laws.values():
        answer = law.respond(empty, empty)
        assert answer.stress.shape == (0, 2, 2)
        assert answer.status.shape == (0,)


def test_one_thread_gives_the_bits_of_two(laws):
    rng = np.random.default_rng(2)
    F = np.eye(2) + rng.uniform(-0.03, 0.03, size=(50, 2, 2))
    F_dot = rng.uniform(-0.005, 0.005, size=(50, 2, 2))
    for law in laws.values():
        many = law.respond(F, F_dot)
        before = numba.get_num_threads()
        numba.set_num_threads(1)
        try:
            one = law.respond(F, F_dot)
        finally:
            numba.set_num_threads(before)
        np.testing.assert_array_equal(one.stress, many.stress)


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["printed", "water"])
def test_an_extreme_state_is_answered_or_refused_soon(laws, preset):
    """Here the limit is the number of solves, on any machine; docs/reliability.md has times."""
    rng, law, solves = np.random.default_rng(4), laws[preset, "slow-manifold"], []
    while len(solves) < 100:
        F = np.eye(2) + 10.0 ** rng.uniform(-1.2, 0.7) * rng.uniform(-1, 1, size=(2, 2))
        if np.linalg.det(F) > 1e-3:
            F_dot = 10.0 ** rng.uniform(-3, 2) * rng.uniform(-1, 1, size=(2, 2))
            solves.append(law.respond(F[None], F_dot[None]).effort["newton_solves"])
    assert 20 < max(solves) <= EFFORT / 15  # most of which take four iterations or more


@pytest.mark.slow
def test_a_hundred_thousand_points(laws):
    F = np.eye(2) + np.random.default_rng(3).uniform(-0.01, 0.01, size=(100_000, 2, 2))
    answer = laws["printed", "constrained-runs"].respond(F, np.zeros_like(F))
    assert not answer.status.any()

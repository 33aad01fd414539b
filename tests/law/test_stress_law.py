"""Stress laws: the slope over a step; paths of one point in time, moduli, free components."""

import numpy as np
import pytest

from surrofe2.base.errors import InputError, SimulationError
from surrofe2.law.paths import follow_path, oscillation, ramp_and_hold
from surrofe2.law.stress_law import SURROGATE, TABLE, Status, describe
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw, RveSettings
from tests.laws import DryFriction, KelvinVoigt
from tests.numerics import assert_near, differences

SHEAR = np.array([[0.0, 1.0], [0.0, 0.0]])
STRETCH = np.array([[1.0, 0.0], [0.0, 0.0]])


def exact_moduli(law, direction, frequency):
    at_rest = law.respond(np.eye(2)[None], np.zeros((1, 2, 2)), tangents=True).tangents
    size = np.sum(direction**2)
    storage, rate = (
        np.einsum("ij,ijkl,kl", direction, slope[0], direction) / size
        for slope in (at_rest.P_by_F, at_rest.P_by_F_dot)
    )
    return storage, 2.0 * np.pi * frequency * rate


@pytest.mark.parametrize("direction", [SHEAR, STRETCH], ids=["shear", "stretch"])
@pytest.mark.parametrize(
    "law",
    [
        KelvinVoigt(),
        RveLaw(CellParameters.preset("water"), initialisation="slow-manifold"),
        RveLaw(CellParameters.preset("printed"), initialisation="constrained-runs"),
    ],
    ids=["viscoelastic", "slow manifold", "constrained runs"],
)
def test_moduli_of_an_oscillation_are_those_of_the_tangents(law, direction):
    frequency = 0.02
    path = follow_path(law, oscillation(direction, 1e-4, frequency), 2.0 / frequency, 80)
    storage, loss = path.modulus(direction, frequency)
    expected = exact_moduli(law, direction, frequency)
    assert storage == pytest.approx(expected[0], rel=5e-3)
    assert loss == pytest.approx(expected[1], rel=5e-3, abs=1e-6 * storage)


def test_held_stretch_relaxes_to_the_elastic_answer_and_free_components_carry_no_stress():
    """After long, as if every rate were zero; on the way there is more stress."""
    law = KelvinVoigt()
    path = follow_path(law, ramp_and_hold(np.diag([1.05, 1.0]), 0.5), 20.0, 400, free=[(1, 1)])
    still = law.respond(path.F[-1:], np.zeros((1, 2, 2))).stress[0]
    np.testing.assert_allclose(path.stress[-1], still, atol=1e-6)
    assert path.stress[:, 0, 0].max() > 1.2 * still[0, 0]
    assert abs(path.first_piola[:, 1, 1]).max() < 1e-8
    assert path.first_piola[-1, 0, 0] > 1.0
    assert path.F[-1, 1, 1] < 1.0


def test_creep_of_a_free_component_is_of_second_order_in_the_step():
    motion = ramp_and_hold(np.diag([1.05, 1.0]), 2.0)
    ends = [
        follow_path(KelvinVoigt(), motion, 2.5, steps, free=[(1, 1)]).F[-1, 1, 1]
        for steps in (20, 40, 80, 640)
    ]
    errors = abs(np.array(ends[:-1]) - ends[-1])
    assert np.log2(errors[:-1] / errors[1:]) == pytest.approx(2.0, abs=0.35)


def test_what_cannot_be_followed_is_said():
    motion = ramp_and_hold(np.diag([1.05, 1.0]), 2.0)
    with pytest.raises(InputError, match=r"free: \[\(2, 0\)\]; entries of F are"):
        follow_path(KelvinVoigt(), motion, 4.0, 20, free=[(2, 0)])
    with pytest.raises(InputError, match="free: DryFriction has no tangents"):
        follow_path(DryFriction(), motion, 4.0, 20, free=[(1, 1)])
    with pytest.raises(InputError, match=r"duration, steps: 4\.0, 0; they must be positive"):
        follow_path(KelvinVoigt(), motion, 4.0, 0)
    law = RveLaw(CellParameters.preset("water"))
    with pytest.raises(SimulationError, match=r"t = .* µs: "):
        follow_path(law, ramp_and_hold(np.diag([2.5, 0.3]), 2.0), 2.0, 2)
    path = follow_path(KelvinVoigt(), motion, 4.0, 20)
    with pytest.raises(InputError, match=r"frequency: 0\.1 per µs; the path must hold a whole"):
        path.modulus(SHEAR, 0.1)


DT = 0.7


@pytest.mark.parametrize(
    "law",
    [KelvinVoigt(), RveLaw(CellParameters.preset("printed"), RveSettings(tolerance=1e-11))],
    ids=["closed form", "RVE"],
)
def test_the_slope_over_a_step_is_that_of_the_first_piola_stress(law):
    """By central differences of P with F_dot = (F − F_old)/dt; P = det F σ F⁻ᵀ."""
    rng = np.random.default_rng(5)
    F, old = np.eye(2) + rng.uniform(-0.02, 0.02, (2, 6, 2, 2))
    answer = law.respond(F, (F - old) / DT, tangents=True)

    def first_piola(F):
        return law.respond(F, (F - old) / DT, answer.state).first_piola(F)

    inverse_T = np.linalg.inv(F).swapaxes(1, 2)
    P = np.linalg.det(F)[:, None, None] * answer.stress @ inverse_T
    np.testing.assert_allclose(answer.first_piola(F), P, atol=1e-13 * abs(P).max())
    assert_near(differences(first_piola, F, 1e-5), answer.tangents.over_step(DT), 2e-6)


def test_codes_of_sources_are_no_reasons():
    """Stresses of surrogate and table have codes that no reason to solve an RVE has."""
    assert SURROGATE != TABLE
    assert not {SURROGATE, TABLE} & {*map(int, Status)}


def test_describe_counts_the_points_of_an_array_by_reason():
    status = np.array([0, 3, 0, 1, 3, 0])
    lines = describe(status).splitlines()
    assert [line.partition(":")[0] for line in lines] == [
        "3 of 6 points",
        "2 of 6 points",
        "1 of 6 points",
    ]
    assert lines[1].endswith(describe(Status.OUT_OF_RANGE))
    assert describe(status[:0]) == ""
    assert describe(status[3]) == describe(Status.NOT_CONVERGED)

"""What a foreign solver asks of an answer: first Piola stress, its slope over a step."""

import numpy as np
import pytest

from surrofe2.law.stress_law import SURROGATE, TABLE, Status
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw, RveSettings
from tests.laws import KelvinVoigt
from tests.numerics import assert_near, differences

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

"""The compiled solves against plain numpy ones, to 1e-10: chord, Newton, slow manifold."""

from functools import cache

import numpy as np
import pytest

from surrofe2.law.stress_law import Status
from tests.rve.rves import PRESETS, deformations, law, particles
from tests.rve.twin import Solver

TIGHT = 1e-11
"""Mean particle force at which both stop, µN."""


@cache
def solver(preset):
    this = law(preset)
    return Solver(this.cell, this.rest_length)


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("initialisation", ["constrained-runs", "elastic", "slow-manifold"])
def test_cold_and_warm_solves_are_those_of_the_twin(preset, initialisation):
    """The twin starts at the compiled z_el or z, moved by 0.01 µm, so that both mean one branch."""
    this = law(preset, initialisation, tolerance=TIGHT)
    points = 2 if initialisation == "constrained-runs" else 1
    F, F_dot = deformations(preset, n=points, corners=False)
    cold = this.respond(F, F_dot)
    near = this.respond(np.eye(2) + 0.98 * (F - np.eye(2)), 0.9 * F_dot)
    warm = this.respond(F, F_dot, near.state)
    assert (cold.status == Status.OK).all()
    assert warm.effort["newton_solves"] == 0 < cold.effort["newton_solves"]
    plain = getattr(solver(preset), initialisation.replace("-", "_"))
    start = 0.01 * np.random.default_rng(4).uniform(-1, 1, this.unit_cell.position.shape)
    start[0] = 0.0
    for point in range(points):
        relaxed = cold.state.relaxed[0, :, :, point].T
        z, stress = plain(F[point], F_dot[point], relaxed + start)
        for answer in (cold, warm):
            np.testing.assert_allclose(
                particles(answer, point), z, rtol=0, atol=1e-10 * abs(z).max()
            )
            np.testing.assert_allclose(
                answer.stress[point], stress, rtol=0, atol=1e-10 * abs(stress).max()
            )

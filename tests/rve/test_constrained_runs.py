"""The compiled iteration against eqs. (69) to (72) written out with their corners and matrices."""

import numpy as np
import pytest

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw, RveSettings
from tests.plant_cell.twin import Twin

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

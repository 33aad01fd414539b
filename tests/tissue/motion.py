"""Particles of a tissue shaken and placed, and whether its forces are those of its energy."""

import numpy as np
import pytest

from surrofe2.tissue import TissueDynamics
from tests.numerics import slope_along


def shaken(tissue, seed=0, amount=0.1):
    """Positions and velocities around the repeated reference, (particles, 2) each."""
    numbers = np.random.default_rng(seed)
    x = tissue.to_particles(tissue.start)
    return (
        x + amount * numbers.uniform(-1, 1, x.shape),
        0.2 * numbers.uniform(-1, 1, x.shape),
    )


def placed(tissue, x, v):
    dynamics = TissueDynamics(tissue)
    dynamics.place(x, v)
    return dynamics


def assert_force_is_minus_the_gradient_of_the_energy(tissue, x, step, directions):
    """At rest at x, along random directions; `step` of the differences, µm."""
    dynamics = placed(tissue, x, 0.0 * x)
    f = dynamics.forces()

    def energy(x):
        dynamics.place(x)
        return dynamics.elastic_energy()

    for seed in range(directions):
        direction = np.random.default_rng(seed).normal(size=x.shape)
        slope = slope_along(energy, x, direction, step)
        size = np.linalg.norm(f) * np.linalg.norm(direction)
        assert slope == pytest.approx(-np.sum(f * direction), abs=1e-7 * size)

"""Laws of RVEs made once, and deformations within their range."""

from functools import cache

import numpy as np

from surrofe2.base.simd import unpack
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw, RveSettings
from tests.plant_cell.twin import IMAGES, Twin

SPREAD = {"printed": 0.08, "water": 0.04}
PRESETS = tuple(SPREAD)


@cache
def law(preset, initialisation="constrained-runs", solver="direct", **settings):
    wanted = RveSettings(initialisation=initialisation, solver=solver, **settings)
    return RveLaw(CellParameters.preset(preset), wanted)


def deformations(preset, n=48, seed=0, corners=True):
    """Random F (entries within SPREAD of I) and Ḟ (within 0.01/µs); some at the range's corners."""
    rng = np.random.default_rng(seed)
    F = rng.uniform(-1, 1, (n, 2, 2))
    if corners:
        F[: n // 4] = np.sign(F[: n // 4])
    return np.eye(2) + SPREAD[preset] * F, 0.01 * rng.uniform(-1, 1, (n, 2, 2))


def positions(state):
    """(points, n, 2) material positions."""
    return unpack(state.z, state.points).transpose(0, 2, 1)


def clear_of_the_cut_off(answer, F, wide=1e-3):
    """(n,) whether no contact sits within `wide` µm of x₀, where tangents are one-sided."""
    clear = []
    offsets = 25.0 * np.array(IMAGES)
    for point, z in enumerate(positions(answer.state)):
        r = (z[None, :, None] + offsets[None, None]) - z[:, None, None]
        length = np.linalg.norm(r @ F[point].T, axis=-1)
        clear.append(np.abs(length - 10.0).min() > wide)
    return np.array(clear)


def piola(this, F, F_dot):
    return this.respond(F, F_dot).first_piola(F)


def assert_balanced(this, answer, F, F_dot, points, felt=None, beyond=None):
    """Over all images, forces at F and `felt`, F_dot by default, vanish; the stress is the twin's.

    beyond: (points, n, 2) velocities beyond affine ones.
    """
    twin = Twin(this.cell, this.rest_length)
    felt, beyond = F_dot if felt is None else felt, np.zeros(len(F)) if beyond is None else beyond
    for point in points:
        z = positions(answer.state)[point]
        f, *_ = twin.evaluate(z, F[point], felt[point], beyond[point])
        assert np.linalg.norm(f, axis=1).mean() < 1e-8
        stress = twin.evaluate(z, F[point], F_dot[point], beyond[point])[2]
        np.testing.assert_allclose(answer.stress[point], stress, rtol=0, atol=1e-9)

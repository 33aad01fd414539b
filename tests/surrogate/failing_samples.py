"""Samples of which some failed, and the group of the square."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from surrofe2.base.tensors import to_inputs
from tests.laws import lattice_samples

G = [
    np.array(g, dtype=float)
    for g in (
        [[1, 0], [0, 1]], [[0, -1], [1, 0]], [[-1, 0], [0, -1]], [[0, 1], [-1, 0]],
        [[1, 0], [0, -1]], [[-1, 0], [0, 1]], [[0, 1], [1, 0]], [[0, -1], [-1, 0]],
    )
]  # fmt: skip


def samples_that_fail(fails, count=4000, seed=1):
    """Samples over `RANGE`, failed where fails(inputs (n, 7)) says so."""
    samples = lattice_samples(count, seed)
    failed = fails(to_inputs(samples.F, samples.F_dot)[0])
    status = np.where(failed, 2, 0).astype(np.int8)
    stress = np.where(failed[:, None, None], np.nan, samples.stress)
    return replace(samples, status=status, stress=stress)


def buckles(x):
    """Compression beyond a curved limit, a little earlier while compressing further."""
    sum_U, difference, shear, rate = x[:, 0], x[:, 1], x[:, 2], x[:, 3]
    return sum_U + 2.0 * rate < -0.07 + 2.0 * difference**2 + 1.5 * shear**2

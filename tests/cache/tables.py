"""A table of the square law, and states to ask it."""

from __future__ import annotations

import numpy as np

from surrofe2.base.sampling import SamplingRange, sample
from surrofe2.cache import StressTable
from tests.laws import SquareLaw, square_stress

RANGE = SamplingRange(stretch=(0.93, 1.07), shear=0.06, rate=0.016)
SPREAD = 3.0


def states(count=50, angle=0.4):
    U, A = sample(RANGE, count, 5)
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return R @ U, R @ A


def make(law=None, tolerance=5e-2, **settings):
    return StressTable(law or SquareLaw(), tolerance * SPREAD, RANGE, SPREAD, **settings)


def taught(F, F_dot, table=None):
    table = table or make()
    table.learn(F, F_dot, square_stress(F, F_dot))
    return table

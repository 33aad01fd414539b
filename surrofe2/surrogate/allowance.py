"""How large an error may be at a point, besides the tolerance that holds everywhere.

    allowed(F, Ḟ) = min(tolerance, 2 b + relative L),    L² = Σ_k (|∂P/∂x_k| x_k)²

in µN/µm. b is the bound of the error at rest, and L the size of the stress that the moduli at rest
give, each of the seven inputs of `tensors` counted by itself, so that it vanishes at rest alone.
A surrogate with the exact tangents at rest has errors of second order there, which stay below.

An error and its bound count tolerance/allowed times; then both are compared with the tolerance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surrofe2.tensors import INPUTS

Array = NDArray[np.float64]

SOLVED = 1e-8
"""Of the spread of stress: true stresses are known no more exactly."""
_AT_REST = 2.0  # times the bound there, so that a point at rest is far from the threshold


def make_allowance(
    sizes: Array, at_rest: float, spread: float, tolerance: float, relative: float
) -> Array:
    """(8,) squares of what each scaled input adds to allowed/tolerance, and what it is at rest.

    Args:
        sizes: (7,) of the stress by each scaled input, µN/µm. at_rest: bound there, µN/µm.
        tolerance: share of the spread, µN/µm; relative: share of the local stress.
    """
    most = tolerance * spread
    return np.append(
        (relative * sizes / most) ** 2, max(_AT_REST * at_rest, SOLVED * spread) / most
    )


def weight(x: Array, allowance: Array) -> Array:
    """(n,) how many times errors count at scaled inputs (n, 7); at least 1."""
    share = allowance[INPUTS] + np.sqrt(x**2 @ allowance[:INPUTS])
    counted: Array = 1.0 / np.minimum(share, 1.0)
    return counted

"""The numpy twin of the compiled test of domains."""

from __future__ import annotations

import numpy as np

from surrofe2.base.tensors import INPUTS
from surrofe2.surrogate.domain import boundary_products, scaled_inputs, values_of


def within(domain, F, F_dot):
    """(n,) whether points (n, 2, 2) are short of the failure boundary."""
    if not len(domain.boundary):
        return np.ones(len(F), dtype=bool)
    x = scaled_inputs(F, F_dot, domain.scale)
    height = values_of(boundary_products(domain.square), x, np.zeros(INPUTS)) @ domain.boundary
    return height <= 0.0

"""The numpy twin of the compiled test of domains."""

from __future__ import annotations

import numpy as np

from surrofe2.surrogate.domain import (
    cliff_table,
    features,
    products,
    reach_of,
    scaled_inputs,
    with_one,
)


def within(domain, F, F_dot):
    """(n,) whether points (n, 2, 2) are inside; False where anything is NaN."""
    with np.errstate(all="ignore"):
        x = scaled_inputs(F, F_dot, domain.scale)
        reach = reach_of(features(x, domain.square), domain.pairs, domain.signs)
        inside = (reach <= domain.limits).all(axis=1)
        if len(domain.cliff):
            height = products(with_one(x), cliff_table(domain.square)) @ domain.cliff
            inside &= height <= 0.0
        return inside

"""From points to records: eight RVEs each, the point and a neighbour along every input."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache.protocols import Fallback
from surrofe2.cache.table_inputs import input_slopes
from surrofe2.cache.table_records import (
    Records,
    curvature_from_constant,
    curvature_from_slopes,
    limited,
    make_records,
)
from surrofe2.tensors import INPUTS, from_inputs, to_components, transpose

Array = NDArray[np.float64]

NEIGHBOUR = 0.1
"""How far a neighbour lies from its record, in half widths of the range."""
MARGIN = 1.2
"""On the second derivatives, for what they change within the ellipsoid."""
_GROUP = 1 + INPUTS


def probed_records(
    law: Fallback,
    x: Array,
    R: Array,
    state: Any,
    points: NDArray[np.intp],
    tolerance: float,
    reach: Array,
) -> tuple[Records, NDArray[np.intp], int]:
    """(records, which of the points they are at, RVE solves) for points x (m, 7) at R (m, 2, 2).

    Where a neighbour has no tangents, the ellipsoid is that of the stress taken as constant; a
    point that has none itself gets no record.

    Args:
        state: the law's warm start, of which `points` (m,) are these, or None.
        tolerance: µN/µm.
        reach: (7,) half widths of the range.
    """
    m = len(x)
    step = NEIGHBOUR * reach
    nearby = (x[:, None] + np.concatenate([np.zeros((1, INPUTS)), np.diag(step)])).reshape(-1, 7)
    frame = np.repeat(R, _GROUP, axis=0)
    F, F_dot = from_inputs(nearby, frame)
    warm = None if state is None else state.take(np.repeat(points, _GROUP))
    answer = law.respond(F, F_dot, warm, tangents=True)
    stress = np.where(answer.status[:, None, None] == 0, answer.stress, 0.0)
    by_F, by_F_dot = answer.tangents.cauchy(F, stress)  # type: ignore[union-attr]
    slopes = input_slopes(frame, by_F, by_F_dot).reshape(m, _GROUP, 4, INPUTS)
    sound = (answer.status == 0).reshape(m, _GROUP) & np.isfinite(slopes).all(axis=(2, 3))
    found = np.flatnonzero(sound[:, 0])
    whole, slopes = sound[found].all(axis=1), slopes[found]
    s = to_components(transpose(frame) @ stress @ frame).reshape(m, _GROUP, 4)[found, 0]
    curvature = curvature_from_constant(slopes[:, 0], tolerance, reach)
    curvature[whole] = limited(
        MARGIN * curvature_from_slopes(slopes[whole, 0], slopes[whole, 1:], step, reach),
        tolerance,
        reach,
    )
    return make_records(x[found], s, slopes[:, 0], curvature), found, len(F)

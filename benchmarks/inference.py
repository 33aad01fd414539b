"""Item 6: the cached law where every point is a hit, beside torch; one thread."""

from __future__ import annotations

from functools import partial

import numpy as np
import torch

from benchmarks.row import Row
from benchmarks.setting import POINTS, Array, Setting, cached
from benchmarks.timing import ratio, side_by_side, threads
from surrofe2 import SurrogateLaw, sample
from surrofe2.base.tensors import to_inputs
from surrofe2.surrogate.network import StressNetwork
from surrofe2.surrogate.piola import to_cauchy

TITLE = "Inference with symmetry, range test and fallback decision"
PRESET = "printed"
LIMITS = {POINTS: 1.0, 5000: 0.7}
"""Points at once → µs a point."""
AGREEMENT = 1e-12


def run(setting: Setting) -> list[Row]:
    """At both numbers of points."""
    surrogate = setting.surrogate(PRESET)
    with threads(1):
        return [row for points in LIMITS for row in _lookup(setting, surrogate, points)]


def _lookup(setting: Setting, surrogate: SurrogateLaw, points: int) -> list[Row]:
    F, F_dot = turned_samples(surrogate, points)
    network = StressNetwork.of(surrogate.network, surrogate.settings)
    law = cached(
        surrogate, PRESET, tolerance=np.inf
    )  # the bound is found and compared all the same
    ours, eager = side_by_side(
        [partial(law.respond, F, F_dot), partial(_torch_stress, network, F, F_dot)],
        setting.pick(25, 7),
    )
    answer, reference = law.respond(F, F_dot), _torch_stress(network, F, F_dot)
    if answer.effort["hits"] != points:
        raise RuntimeError(f"{points - answer.effort['hits']} of {points} points were no hits")
    difference = float(abs(answer.stress - reference).max() / abs(reference).max())
    per_point = 1e6 / points
    name = f"{points:,} points"
    return [
        Row(
            name=f"{name}: a point",
            value=ours.median * per_point,
            spread=ours.spread * per_point,
            unit="µs",
            limit=LIMITS[points],
            baseline="torch eager, without range test",
            baseline_value=eager.median * per_point,
            ratio=ratio(eager, ours),
        ),
        Row(
            name=f"{name}: largest difference from torch / largest stress",
            value=difference,
            unit="",
            limit=AGREEMENT,
        ),
    ]


def turned_samples(surrogate: SurrogateLaw, points: int) -> tuple[Array, Array]:
    """(R U, R A) with (U, A) over the surrogate's range, but for its very edge, and any R."""
    U, A = sample(surrogate.range, 4 * points, seed=5)
    inside = surrogate.in_range(U, A).nonzero()[0][:points]
    U, A = U[inside], A[inside]
    angle = np.random.default_rng(5).uniform(-np.pi, np.pi, points)
    c, s = np.cos(angle), np.sin(angle)
    R = np.stack([c, -s, s, c], axis=1).reshape(-1, 2, 2)
    shrunk = 0.999
    U = np.eye(2) + shrunk * (U - np.eye(2))
    return np.ascontiguousarray(R @ U), np.ascontiguousarray(R @ (shrunk * A))


def _torch_stress(network: StressNetwork, F: Array, F_dot: Array) -> Array:
    """Cauchy stress (n, 2, 2) by the torch network."""
    with torch.no_grad():
        return to_cauchy(F, network(torch.from_numpy(to_inputs(F, F_dot)[0])).numpy())

"""Gradients of an RVE's stress by the parameters of its plant cell, for identification.

They are central differences of whole laws, 1e-5 of a parameter to either side, so that whatever
follows from a parameter changes with it: constants of the pair laws, wall rest length, box. A
gradient takes two laws, settled from the reference state of the first, and two cold solves per
point. Its error is about 1e-7 of the largest: 1e-8 by the difference, as much by the tolerance of
the law.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError, SimulationError, quoted
from surrofe2.base.tensors import cofactor
from surrofe2.law.paths import StressPath
from surrofe2.law.stress_law import StressResponse, check_deformation, describe, require_tangents
from surrofe2.rve.rve_law import RveLaw
from surrofe2.rve.unit_cell import resettled

DASHPOTS = ("viscosity", "wall_damping_ratio", "contact_damping_ratio")
PARAMETERS = (
    "wall_stiffness", "wall_particle_mass", "fluid_particle_mass", "sound_speed",
    "repulsion_strength", "repulsion_cutoff", "smoothing_length", *DASHPOTS, "cell_side",
)  # fmt: skip
"""Parameters that the stress depends on smoothly."""
OF_UNIFORM_FLUID = ("sap_bulk_modulus",)
"""Further ones where the fluid is uniform."""
_STEP = 1e-5
"""Relative step of the differences."""
_DASHPOT_STEP = 2e-3
"""Relative step for dashpots, which act little and almost linearly."""
_CENTRAL = {-1: -0.5, 1: 0.5}
"""Weights of a central difference, by the number of steps from the parameter."""
_ONE_SIDED = {0: -1.5, 1: 2.0, 2: -0.5}
"""Weights of a one-sided difference of second order, for parameters that are 0."""


@dataclass(frozen=True, slots=True)
class StressGradients:
    """Stress of an RVE at n points, and its gradients by parameters.

    Attributes:
        answer: stress and tangents.
        P_by: ∂P/∂parameter (n, 2, 2) at fixed F and Ḟ by the parameter's name, in µN/µm over its
            unit; NaN where there is no stress.
    """

    answer: StressResponse
    P_by: Mapping[str, Array]


def parameter_gradients(
    law: RveLaw, F: Any, F_dot: Any, names: Sequence[str] | None = None
) -> StressGradients:
    """Compute the stress at n points, its tangents, and its gradients by some of `PARAMETERS`.

    Gradients are wrong where a pair of particles crosses the cut-off within the difference.

    Args:
        names: names of parameters; None: all that the plant cell has.

    Raises:
        InputError: another parameter, as of `respond`, the law has no tangents, or its plant cells
            are irregular, whose reference state may jump.
    """
    known = PARAMETERS + (OF_UNIFORM_FLUID if law.cell.has_uniform_fluid else ())
    names = known if names is None else names
    for name in names:
        if name not in known:
            raise InputError(f"names: {quoted(name)}; it must be among {', '.join(known)}")
    require_tangents(law, "parameter_gradients")
    if law.cell.arrangement == "voronoi":
        raise InputError("law: voronoi; gradients by parameters need squares or hexagons")
    F, F_dot = check_deformation(F, F_dot)
    answer = law.respond(F, F_dot, tangents=True)
    gradients = {name: _difference(law, F, F_dot, name) for name in names}
    for slopes in gradients.values():
        slopes[answer.status != 0] = np.nan
    return StressGradients(answer, gradients)


def _difference(law: RveLaw, F: Array, F_dot: Array, name: str) -> Array:
    """Return ∂P/∂parameter (n, 2, 2) by a difference of second order in the step.

    It is one-sided where the parameter is 0, which may not be negative.
    """
    value = law.cell.to_dict()[name]
    relative_step = _DASHPOT_STEP if name in DASHPOTS else _STEP
    step = relative_step * (value or 1.0)
    weights = _CENTRAL if value else _ONE_SIDED
    slopes = np.zeros_like(F)
    for steps, weight in weights.items():
        cell = replace(law.cell, **{name: value + steps * step})
        moved = RveLaw(cell, law.settings, reference=resettled(cell, law.reference))
        slopes += weight / step * moved.respond(F, F_dot).stress @ cofactor(F)
    return slopes


def path_gradients(
    law: RveLaw,
    path: StressPath,
    names: Sequence[str] | None = None,
    *,
    free: Sequence[tuple[int, int]] = (),
) -> dict[str, Array]:
    """Compute how P changes with parameters along a path of `follow_path` by the same law.

    Args:
        names: names of parameters; None: all that the plant cell has.
        free: entries of F that the path left free of stress. Their creep changes with parameters,
            too, by the same BDF 2.

    Returns:
        dP/dparameter (n, 2, 2), µN/µm over its unit, by the parameter's name.

    Raises:
        SimulationError: a point of the path has no stress where it is computed again.
    """
    gradients = parameter_gradients(law, path.F, path.F_dot, names)
    failed = np.flatnonzero(gradients.answer.status)
    if failed.size:
        why = describe(gradients.answer.status[failed[0]])
        raise SimulationError(f"t = {path.t[failed[0]]:.6g} µs: {why}")
    tangents = gradients.answer.tangents
    assert tangents is not None
    total = {name: values.copy() for name, values in gradients.P_by.items()}
    if not len(free):
        return total
    entries = tuple(np.array(free, dtype=np.int64).reshape(-1, 2).T)
    columns: Any = (slice(None), slice(None), slice(None), *entries)  # P by the free entries
    by_F = tangents.P_by_F[columns]
    by_rate = tangents.P_by_F_dot[columns]
    h = path.t[1] - path.t[0]
    for values in total.values():
        dF = np.zeros((len(path.t), len(free)))
        for n in range(1, len(path.t)):
            # the rate of F is (F − base)/weight: backward Euler in the first step, then BDF 2
            base = dF[n - 1]
            weight = h
            if n > 1:
                base = (4.0 * dF[n - 1] - dF[n - 2]) / 3.0
                weight = 2.0 * h / 3.0
            # P stays 0 in the free entries
            matrix = (by_F[n] + by_rate[n] / weight)[entries]
            change = -values[n][entries] + by_rate[n][entries] @ base / weight
            dF[n] = np.linalg.solve(matrix, change)
            values[n] += by_F[n] @ dF[n] + by_rate[n] @ ((dF[n] - base) / weight)
    return total

"""Gradients of an RVE's stress by the parameters of its plant cell, for identification.

A parameter changes constants of the pair laws (`constant_slopes`), and with them the wall rest
length l₀, which follows from σ(I, 0) = 0. The side of a plant cell is the size of its box; one of
(1 + e) A in the place of A is the old one at (1 + e) F, so that

    δP/e = ∂P/∂F : F + ∂P/∂Ḟ : Ḟ − P
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError, SimulationError, quoted
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.tiles import Constants, pack, unpack
from surrofe2.rve.constant_slopes import affine_constant_slopes, slow_constant_slopes
from surrofe2.rve.particle_state import Drive
from surrofe2.rve.rve_law import RveLaw
from surrofe2.rve.tangents import KINDS
from surrofe2.simd import TILE
from surrofe2.stress_law import StressResponse, check_deformation, describe, require_tangents
from surrofe2.stress_paths import StressPath
from surrofe2.tensors import cofactor

Array = NDArray[np.float64]

PARAMETERS = (
    "wall_stiffness", "wall_particle_mass", "fluid_particle_mass", "sound_speed", "viscosity",
    "repulsion_strength", "repulsion_cutoff", "smoothing_length", "wall_damping_ratio",
    "contact_damping_ratio", "cell_side",
)  # fmt: skip
"""Those that enter the stress smoothly."""
_STEP, _DASHPOT_STEP = 1e-5, 0.5
"""Of a constant, relative, for its central difference; forces are linear in dashpots, and small."""
_DASHPOTS = ("viscosity", "wall_damping", "contact_damping")
_SIZE = "size"
"""Relative, of the box."""


@dataclass(frozen=True, slots=True)
class StressGradients:
    """What an RVE answers at n points, and how that changes with its parameters.

    Attributes:
        answer: stress and tangents.
        P_by: by parameter (n, 2, 2) ∂P/∂parameter at fixed F and Ḟ, in µN/µm over its unit; NaN
            where there is no stress.
    """

    answer: StressResponse
    P_by: Mapping[str, Array]


def parameter_gradients(
    law: RveLaw, F: Any, F_dot: Any, names: Sequence[str] = PARAMETERS, state: Any = None
) -> StressGradients:
    """Stress at n points, its tangents, and its gradients by some of `PARAMETERS`.

    They are one-sided where a pair of particles sits at the cut-off.

    Raises:
        InputError: another parameter, as of `respond`, the law has no tangents or is by
            Cauchy–Born, whose particles lie where the parameters put them, or its cells are
            irregular, whose box moves with them.
    """
    for name in names:
        if name not in PARAMETERS:
            raise InputError(f"names: {quoted(name)}; it must be among {', '.join(PARAMETERS)}")
    require_tangents(law, "parameter_gradients")
    if law.initialisation == "cauchy-born" or law.cell.arrangement == "voronoi":
        raise InputError(
            f"law: {law.initialisation}, {law.cell.arrangement}; gradients by parameters need "
            "particles that relax and square plant cells or hexagons"
        )
    F, F_dot = check_deformation(F, F_dot)
    rest, still = np.eye(2)[None], np.zeros((1, 2, 2))
    changes = {name: _constant_slopes(law.cell, law.unit_cell.constants, name) for name in names}
    used = {constant for change in changes.values() for constant in change} - {_SIZE}
    constants = (*sorted(used), "rest_length")
    at_rest = _Point(law, rest, still, None, constants)
    here = _Point(law, F, F_dot, state, constants)
    found = {}
    for name, change in changes.items():
        direct, balance = (
            sum(slope * point.by[key] for key, slope in change.items()) for point in (here, at_rest)
        )
        # l₀ balances what the parameter does to the stress at rest
        length = -np.trace(balance[0]) / np.trace(at_rest.by["rest_length"][0])
        found[name] = direct + length * here.by["rest_length"]
    return StressGradients(here.answer, found)


class _Point:
    """Answer of a law at points, and by constant, and by the size of the box, slopes of P."""

    def __init__(
        self, law: RveLaw, F: Array, F_dot: Array, state: Any, constants: Sequence[str]
    ) -> None:
        self.answer = law.respond(F, F_dot, state, tangents=True)
        self.F, self.F_dot = F, F_dot
        self.P = self.answer.stress @ cofactor(F)
        tangents = self.answer.tangents
        assert tangents is not None
        size = np.einsum("nabcd,ncd->nab", tangents.P_by_F, F) - self.P
        size += np.einsum("nabcd,ncd->nab", tangents.P_by_F_dot, F_dot)
        slopes = zip(constants, _slopes(law, self, constants), strict=True)
        self.by = {**dict(slopes), _SIZE: size}


def _slopes(law: RveLaw, point: _Point, names: Sequence[str]) -> Array:
    """(m, n, 2, 2) ∂P/∂constant at fixed l₀ and box."""
    state, given = point.answer.state, law.unit_cell.constants
    values = np.tile(given, (2, len(names), 1))
    widths = np.empty(len(names))
    for m, name in enumerate(names):
        k = Constants._fields.index(name)
        step = (_DASHPOT_STEP if name in _DASHPOTS else _STEP) * (given[k] or 1.0)
        values[0, m, k] += step
        values[1, m, k] -= step
        widths[m] = values[0, m, k] - values[1, m, k]
    drive = Drive(pack(point.F), pack(point.F_dot))
    slopes = np.empty((len(state.z), len(names), 4, TILE))
    topology = law.covering_topology(state)
    if law.initialisation == "slow-manifold":
        slow_constant_slopes(drive, state.z, state.relaxed, topology, given, values, slopes)
        if state.left.any():  # velocities are affine there, see `slow_solution`
            held, kind = np.empty_like(slopes), KINDS.index("constrained-runs")
            affine_constant_slopes(drive, state.z, kind, topology, given, values, held)
            np.copyto(slopes, held, where=state.left[:, None, None, :])
    else:
        kind = KINDS.index(law.initialisation)
        affine_constant_slopes(drive, state.z, kind, topology, given, values, slopes)
    found = unpack(slopes, state.points).transpose(1, 0, 2) / widths[:, None, None]
    found[:, point.answer.status != 0] = np.nan
    return np.ascontiguousarray(found.reshape(len(names), -1, 2, 2))


def _constant_slopes(cell: CellParameters, c: Constants, name: str) -> dict[str, float]:
    """∂constant/∂parameter of what `make_constants` makes of a parameter."""
    if name in ("wall_stiffness", "repulsion_strength"):
        own, damping = (
            ("wall_stiffness", "wall_damping")
            if name == "wall_stiffness"
            else ("repulsion", "contact_damping")
        )
        return {own: 1.0, damping: 0.5 * c._asdict()[damping] / c._asdict()[own]}
    if name == "wall_particle_mass":
        m = cell.wall_particle_mass
        return {"wall_damping": 0.5 * c.wall_damping / m,
                "contact_damping": 0.5 * c.contact_damping / m}  # fmt: skip
    mass, k, strength = cell.wall_particle_mass, cell.wall_stiffness, cell.repulsion_strength
    others = {
        "fluid_particle_mass": {"fluid_mass": cell.fluid_mass / cell.fluid_particle_mass},
        "sound_speed": {"sound_speed_squared": 2.0 * cell.sound_speed},
        "viscosity": {"viscosity": 1.0},
        "repulsion_cutoff": {"cutoff": 1.0},
        "smoothing_length": {"smoothing_length": 1.0},
        "wall_damping_ratio": {"wall_damping": 2.0 * float(np.sqrt(mass * k))},
        "contact_damping_ratio": {"contact_damping": 2.0 * float(np.sqrt(6.0 * strength * mass))},
        "cell_side": {_SIZE: 1.0 / cell.cell_side},
    }
    return others[name]


def path_gradients(
    law: RveLaw,
    path: StressPath,
    names: Sequence[str] = PARAMETERS,
    *,
    free: Sequence[tuple[int, int]] = (),
) -> dict[str, Array]:
    """(n, 2, 2) by parameter: how P changes along a path of `follow_path` by the same law.

    Args:
        free: entries of F that the path left free of stress; how they creep changes, too, by the
            same BDF 2.

    Raises:
        SimulationError: a point of the path has no stress where it is asked anew.
    """
    found = parameter_gradients(law, path.F, path.F_dot, names)
    failed = np.flatnonzero(found.answer.status)
    if failed.size:
        why = describe(found.answer.status[failed[0]])
        raise SimulationError(f"t = {path.t[failed[0]]:.6g} µs: {why}")
    tangents = found.answer.tangents
    assert tangents is not None
    total = {name: values.copy() for name, values in found.P_by.items()}
    if not len(free):
        return total
    entries = tuple(np.array(free, dtype=np.int64).reshape(-1, 2).T)
    columns: Any = (slice(None), slice(None), slice(None), *entries)  # P by the free entries
    by_F, by_rate = tangents.P_by_F[columns], tangents.P_by_F_dot[columns]
    h = path.t[1] - path.t[0]
    for values in total.values():
        dF = np.zeros((len(path.t), len(free)))
        for n in range(1, len(path.t)):
            base, weight = dF[n - 1], h
            if n > 1:
                base, weight = (4.0 * dF[n - 1] - dF[n - 2]) / 3.0, 2.0 * h / 3.0
            # P = 0 in the free entries, whose rate is (F − base)/weight
            whole = (by_F[n] + by_rate[n] / weight)[entries]
            change = -values[n][entries] + by_rate[n][entries] @ base / weight
            dF[n] = np.linalg.solve(whole, change)
            values[n] += by_F[n] @ dF[n] + by_rate[n] @ ((dF[n] - base) / weight)
    return total

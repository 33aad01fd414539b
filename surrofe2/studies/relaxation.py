"""Figure 6: mean particle force and error of the state over the iterations of each solver.

From the undeformed RVE to F₁₀ (eq. 73) with Ḟ of (74). The state matrix of section 5.4 is
𝒳 = [x; v], 4 × particles, in µm and µm/µs; the error is the spectral norm of the difference from
the fixed point of constrained runs, which Newton finds to 1e-11 µN.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import SimulationError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.tiles import pack
from surrofe2.report.figures import Curve, Panel
from surrofe2.report.study import Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.rve import RveLaw, RveSettings
from surrofe2.rve.constrained_runs import Stepping, iterate
from surrofe2.rve.newton import SOLVE, newton
from surrofe2.rve.particle_state import Drive, empty_answer, stress_at
from surrofe2.rve.rve_state import Factors
from surrofe2.rve.unit_cell import UnitCell
from surrofe2.simd import TILE
from surrofe2.stress_law import Status
from surrofe2.studies.drives import steady_shear

Array = NDArray[np.float64]

DIRECT, ELASTIC, RUNS = "direct", "elastic", "constrained-runs"
STOP = 1.0
"""Mean force at which the paper's iteration stops, µN (section 6.2)."""
_NEVER = -1.0
_REFERENCE_TOLERANCE = 1e-11


@dataclass(frozen=True, slots=True)
class Relaxation:
    """One solver's way. iterations: (k,); mean_force: (k,) µN; error: (k,) of the state matrix."""

    iterations: NDArray[np.int64]
    mean_force: Array
    error: Array

    def first_below(self, force: float) -> int | None:
        """The first recorded iteration with a mean force below this, or None."""
        below = np.flatnonzero(self.mean_force < force)
        return int(self.iterations[below[0]]) if below.size else None


def relaxations(
    cell: CellParameters,
    shear: float = 0.1,
    *,
    limit: int = 50_000,
    micro_step: float = 1e-4,
    samples: int = 120,
) -> dict[str, Relaxation]:
    """Elastic relaxation, constrained runs and Newton from the undeformed RVE.

    Elastic relaxation iterates with Ḟ = 0; its state then gets the velocities L x of (67). Its
    mean force is that without velocities, which the relaxation brings to zero.

    Args:
        limit: Euler steps of the first two.
        samples: iterations that are recorded, evenly spaced in the logarithm.
    """
    F, F_dot = steady_shear(start=shear)(0.0)
    unit = RveLaw(cell).unit_cell
    reference = _fixed_point(cell, F, F_dot)
    spaced = np.rint(np.geomspace(1.0, limit, samples)).astype(np.int64)
    counts = np.unique(np.concatenate([[0], spaced]))
    L = F_dot @ np.linalg.inv(F)

    def iterated(rate: Array) -> Relaxation:
        """The paper's iteration with this rate, interrupted at each of the counts."""
        drive, answer = Drive(pack(F[None]), pack(rate[None])), empty_answer(1)
        X, mass = unit.position.T, unit.patches[0].mass
        x, v = _tile(F @ X), _tile(rate @ X)
        forces, errors = [], []
        for count in np.diff(counts, prepend=0):
            stepping = Stepping(micro_step, _NEVER, int(count))
            iterate(drive, x, v, mass, unit.topologies[-1], unit.constants, stepping, answer)
            forces.append(answer.residual[0, 0, 0])
            there = x[0, :, :, 0]
            velocity = v[0, :, :, 0] if rate.any() else L @ there
            errors.append(_distance(there, velocity, reference))
        return Relaxation(counts, np.array(forces), np.array(errors))

    found = {ELASTIC: iterated(np.zeros((2, 2))), RUNS: iterated(F_dot)}
    found[DIRECT] = _newton_steps(unit, F, F_dot, reference)
    return found


def _fixed_point(cell: CellParameters, F: Array, F_dot: Array) -> Array:
    """State matrix (4, particles) of the direct solve."""
    law = RveLaw(cell, RveSettings(initialisation=RUNS, tolerance=_REFERENCE_TOLERANCE))
    answer = law.respond(F[None], F_dot[None])
    if answer.status[0] != Status.OK:
        raise SimulationError("relaxation: the direct solve finds no fixed point of this cell")
    z = answer.state.z[0, :, :, 0]
    return np.concatenate([F @ z, F_dot @ z])


def _newton_steps(unit: UnitCell, F: Array, F_dot: Array, reference: Array) -> Relaxation:
    """Newton's iterates: the states at which it stops as its tolerance is lowered."""
    drive, task = Drive(pack(F[None]), pack(F_dot[None])), np.full(1, SOLVE, dtype=np.int8)
    law = unit.topologies[-1], unit.constants
    rows: dict[int, tuple[float, float]] = {}
    for tolerance in np.geomspace(1e5, _REFERENCE_TOLERANCE, 65):
        z, factors, answer = _tile(unit.position.T), Factors.empty(1, law[0]), empty_answer(1)
        newton(drive, z, factors.address, task, *law, float(tolerance), answer)
        count = int(answer.iterations[0, 0]) - 1
        if count < 0 or count in rows:
            continue
        stress_at(drive, z, *law, answer)
        there = z[0, :, :, 0]
        error = _distance(F @ there, F_dot @ there, reference)
        rows[count] = float(answer.residual[0, 0, 0]), error
    counts = np.array(sorted(rows))
    return Relaxation(counts, *np.array([rows[int(k)] for k in counts]).T)


def _tile(values: Array) -> Array:
    """(2, particles) → (1, 2, particles, TILE)."""
    return np.ascontiguousarray(np.repeat(values[None, ..., None], TILE, axis=-1))


def _distance(x: Array, v: Array, reference: Array) -> float:
    return float(np.linalg.norm(np.concatenate([x, v]) - reference, 2))


_LABELS = {
    ELASTIC: "elastic relaxation (Euler steps)",
    RUNS: "constrained runs (Euler steps)",
    DIRECT: "constrained runs, direct solve (Newton steps)",
}
QUANTITIES: tuple[Quantity[tuple[str, Relaxation]], ...] = (
    Quantity("method", "", "", lambda row: row[0]),
    Quantity("iterations to mean force 1", "", "d", lambda row: row[1].first_below(STOP)),
    Quantity("last iteration", "", "d", lambda row: int(row[1].iterations[-1])),
    Quantity("last mean force", "µN", ".3g", lambda row: float(row[1].mean_force[-1])),
    Quantity("last error", "µm and µm/µs", ".3g", lambda row: float(row[1].error[-1])),
)


def describe(ways: dict[str, Relaxation]) -> Study:
    """Figure 6: error of the state at the left, mean force at the right."""
    error, force = "error of the state (µm and µm/µs)", "mean particle force (µN)"

    def panel(label: str, values: Callable[[Relaxation], Array]) -> Panel:
        curves = []
        for name, text in _LABELS.items():
            x, y = ways[name].iterations.astype(float), values(ways[name])
            curves.append(Curve(name, x, y, text, markers=name == DIRECT))
        return Panel("iterations", label, tuple(curves), log_x=True, log_y=True)

    def column(values: Callable[[Relaxation], NDArray[Any]]) -> NDArray[Any]:
        return np.concatenate([values(way) for way in ways.values()])

    return Study(
        title="Figure 6: from the undeformed RVE to shear 0.1 at rate 0.01/µs",
        panels=(panel(error, lambda way: way.error), panel(force, lambda way: way.mean_force)),
        columns=2,
        table=Table(QUANTITIES, tuple(ways.items())),
        series={
            "method": [method for method, way in ways.items() for _ in way.iterations],
            "iterations": column(lambda way: way.iterations),
            "mean force (µN)": column(lambda way: way.mean_force),
            error: column(lambda way: way.error),
        },
    )

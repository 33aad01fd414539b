"""One RVE by each initialisation against itself integrated in time, and its iterations.

Figure 5: stress over shear steps F_α (eq. 73), at rest and at a rate. Figure 6: mean particle force
and error of the state over the iterations of each solver.

Rates: the same path through F, slowed by s, has Ḟ ∝ 1/s and F̈ ∝ 1/s². The stress of Cauchy–Born is
wrong by O(1), elastic equilibrium and constrained runs by O(Ḟ), the slow manifold by O(Ḟ², F̈):
orders 0, 1, 1, 2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import SimulationError
from surrofe2.base.simd import TILE, pack
from surrofe2.law.stress_law import Status
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.questions.memory import steady_shear
from surrofe2.report.study import Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.run.charts import Curve, Panel
from surrofe2.rve import INITIALISATIONS, RveLaw, RveSettings
from surrofe2.rve.constrained_runs import Stepping, iterate
from surrofe2.rve.micro_integration import integrate_rve
from surrofe2.rve.newton import SOLVE, newton
from surrofe2.rve.rve_state import Drive, Factors, empty_answer, stress_at
from surrofe2.rve.unit_cell import UnitCell
from validation.case import Setting

Array = NDArray[np.float64]

SHEAR_RATE = 0.01
"""Ḟ_xy of eq. (74), 1/µs."""
INTEGRATED = "micro-integration"
_SETTLED = 0.02
"""Shear from which the integrated line is compared: its start from rest has died away."""
_COMPONENTS = {"xy": (0, 1), "xx": (0, 0)}
EXPECTED = {"cauchy-born": 0, "elastic": 1, "constrained-runs": 1, "slow-manifold": 2}
"""Order in the rate of the error of each initialisation."""
SLOWNESS = (1.0, 2.0, 4.0, 8.0)
THICKNESS = CellParameters().tissue_thickness
"""µm, of the presets: stresses of the plane over it are in MPa."""


@dataclass(frozen=True, slots=True)
class ShearSteps:
    """Stress over shear at one rate.

    Attributes:
        rate: Ḟ_xy, 1/µs.
        shear: (m,) F_xy.
        stress: by initialisation and, at a rate, "micro-integration": (m, 2, 2) µN/µm.
        unstable_from: by initialisation, the first shear whose equilibrium is unstable or was not
            found; None where all are well.
    """

    rate: float
    shear: Array
    stress: Mapping[str, Array]
    unstable_from: Mapping[str, float | None]

    @property
    def reference(self) -> str:
        """What the others are compared with: the integrated line, else elastic equilibrium."""
        return INTEGRATED if INTEGRATED in self.stress else "elastic"

    def difference(self, method: str) -> tuple[Array, Array]:
        """Shear (k,) where it is compared with the reference, and |Δσ| there (k, 2, 2)."""
        compared = self.shear >= (_SETTLED if self.reference == INTEGRATED else 0.0)
        error = np.abs(self.stress[method] - self.stress[self.reference])
        return self.shear[compared], error[compared]


def shear_steps(
    cell: CellParameters,
    rate: float = SHEAR_RATE,
    *,
    steps: int = 20,
    increment: float = 0.01,
    micro_step: float = 1e-3,
) -> ShearSteps:
    """Shear an RVE in steps, each from the state of the last one (section 6.1).

    At a rate the RVE is integrated in time, too: from F₀ at rest under constant Ḟ, so that it
    passes F_α at t = 0.01 α/Ḟ_xy.
    """
    shear: Array = increment * np.arange(steps + 1, dtype=np.float64)
    stress, trouble = {}, {}
    for name in INITIALISATIONS:
        stress[name], trouble[name] = _sheared(RveLaw(cell, initialisation=name), shear, rate)
    if rate != 0.0:
        times = shear / rate
        stress[INTEGRATED] = integrate_rve(RveLaw(cell), steady_shear(rate), times, micro_step)
    return ShearSteps(rate, shear, stress, trouble)


def _sheared(law: RveLaw, shear: Array, rate: float) -> tuple[Array, float | None]:
    state, stresses, trouble = None, [], None
    for value in shear:
        F, F_dot = (tensor[None] for tensor in steady_shear(rate, float(value))(0.0))
        answer = law.respond(F, F_dot, state)
        stresses.append(answer.stress[0])
        status, state = answer.status[0], None
        if status == Status.OK:
            accepted = law.accept(F, F_dot, answer)
            status, state = accepted.status[0], accepted.state
        if trouble is None and status != Status.OK:
            trouble = float(value)
    return np.array(stresses), trouble


FIGURE_5: tuple[Quantity[tuple[ShearSteps, str]], ...] = (
    Quantity("method", "", "", lambda row: row[1]),
    Quantity("rate", "1/µs", "g", lambda row: row[0].rate),
    Quantity("reference", "", "", lambda row: row[0].reference),
    Quantity(
        "largest difference",
        "µN/µm",
        ".3g",
        lambda row: float(np.nanmax(row[0].difference(row[1])[1])),
    ),
    Quantity("unstable from shear", "", "g", lambda row: row[0].unstable_from[row[1]]),
)


_AGAINST = {INTEGRATED: "the RVE integrated in time", "elastic": "elastic relaxation"}


def figure_5(setting: Setting) -> Study:
    """σ over shear at rest and at a rate."""
    return describe_shear([shear_steps(setting.of.cell, rate) for rate in (0.0, SHEAR_RATE)])


def describe_shear(runs: Sequence[ShearSteps]) -> Study:
    """σ_xy and σ_xx above, at the last rate; below, how far they are from the RVE integrated in
    time, or from elastic equilibrium.

    Stresses at other rates are in the table alone: they differ by less than the width of a line.
    """
    run = runs[-1]
    apart = {name: run.difference(name) for name in INITIALISATIONS}
    above = [
        Panel(
            x_label="shear $F_{xy}$",
            y_label=rf"$\sigma_{{{label}}}$ (MPa)",
            curves=tuple(
                Curve(name, run.shear, stress[:, a, b] / THICKNESS, markers=False)
                for name, stress in run.stress.items()
            ),
        )
        for label, (a, b) in _COMPONENTS.items()
    ]
    below = [
        Panel(
            title=f"distance from {_AGAINST[run.reference]}",
            x_label="shear $F_{xy}$",
            y_label=rf"$|\Delta\sigma_{{{label}}}|$ (MPa)",
            curves=tuple(Curve(name, x, e[:, a, b] / THICKNESS) for name, (x, e) in apart.items()),
            log_y=True,
        )
        for label, (a, b) in _COMPONENTS.items()
    ]
    return Study(
        title=f"Figure 5: stress of one RVE over shear steps at rate {run.rate:g}/µs",
        panels=(*above, *below),
        columns=2,
        table=Table(
            FIGURE_5, [(r, name) for r in runs for name in r.stress if name != r.reference]
        ),
    )


@dataclass(frozen=True, slots=True)
class RateErrors:
    """rate: (k,) largest entry of Ḟ, 1/µs. error: by initialisation, (k,) largest stress error,
    µN/µm."""

    rate: Array
    error: Mapping[str, Array]

    def order(self, name: str) -> float:
        """Slope of log error over log rate, by least squares."""
        return float(np.polyfit(np.log(self.rate), np.log(self.error[name]), 1)[0])


def rate_errors(
    cell: CellParameters,
    slowness: Sequence[float] = SLOWNESS,
    *,
    times: Sequence[float] = (0.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0, 18.0, 20.0),
    micro_step: float = 2e-3,
) -> RateErrors:
    """Stress errors along F₁₁ = 1 + 0.04 sin ωt, F₁₂ = 0.05 sin ωt, ω = 2π/40 µs, slowed.

    Args:
        times: µs at slowness 1, from rest; all but the first are compared, the start's own
            motion having died away.
    """
    laws = {name: RveLaw(cell, initialisation=name) for name in INITIALISATIONS}
    errors: dict[str, list[float]] = {name: [] for name in laws}
    rates = []
    amplitude = np.array([[0.04, 0.05], [0.0, 0.0]])
    for slow in slowness:
        omega, moments = 2.0 * np.pi / (40.0 * slow), slow * np.array(times)

        def path(t: float, omega: float = omega) -> tuple[Array, Array]:
            F = np.eye(2) + np.sin(omega * t) * amplitude
            return F, omega * np.cos(omega * t) * amplitude

        exact = integrate_rve(laws["elastic"], path, moments, micro_step)[1:]
        F, F_dot = (np.array(each) for each in zip(*map(path, moments), strict=True))
        for name, law in laws.items():
            errors[name].append(float(np.abs(law.respond(F[1:], F_dot[1:]).stress - exact).max()))
        rates.append(float(np.abs(F_dot).max()))
    error = {name: np.array(values) for name, values in errors.items()}
    return RateErrors(np.array(rates), error)


def rates(setting: Setting) -> Study:
    """The log-log figure with its fitted orders."""
    errors = rate_errors(setting.of.cell)
    quantities: tuple[Quantity[str], ...] = (
        Quantity("initialisation", "", "", lambda name: name),
        Quantity("order", "", ".3f", errors.order),
        Quantity("expected order", "", "d", EXPECTED.get),
        Quantity("largest error", "µN/µm", ".3g", lambda name: float(errors.error[name].max())),
    )
    curves = []
    for name, error in errors.error.items():
        curve = Curve(name, errors.rate, error / THICKNESS)
        label = f"{curve.words}, order {abs(errors.order(name)):.2f}"
        curves.append(replace(curve, label=label))
    slopes = []
    # halfway to the next curve, so that the slope is seen beside that of the errors
    for order, beside in ((1, "elastic"), (2, "slow-manifold")):
        middle = 2.2 * errors.error[beside][0] / THICKNESS
        rate = errors.rate[::-1]  # the note stands at the largest
        line = middle * (rate / rate[-1]) ** order
        slopes.append(Curve("guide", rate, line, markers=False, note=f"slope {order}"))
    panel = Panel(
        x_label=r"largest rate $|\dot F|$ ($10^{-3}$ µs$^{-1}$)",
        y_label="largest stress error (MPa)",
        curves=(*curves, *slopes),
        log_x=True,
        log_y=True,
        x_ticks=tuple(errors.rate),
        x_names=tuple(f"{1000.0 * rate:.2g}" for rate in errors.rate),
    )
    return Study(
        title="Error of each initialisation against the RVE integrated in time,\n"
        f"oscillating drive slowed by {', '.join(f'{slow:g}' for slow in SLOWNESS)}",
        panels=(panel,),
        table=Table(quantities, tuple(errors.error)),
    )


DIRECT, ELASTIC, RUNS = "direct", "elastic", "constrained-runs"
STOP = 1.0
"""Mean force at which the paper's iteration stops, µN (section 6.2)."""
_NEVER = -1.0
_REFERENCE_TOLERANCE = 1e-11


@dataclass(frozen=True, slots=True)
class Relaxation:
    """A solver's iterations (k,), mean_force (k,) µN, and error (k,) of the state matrix."""

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
    """Elastic relaxation, constrained runs and Newton from the undeformed RVE to F₁₀ (eq. 73).

    The state matrix of section 5.4 is 𝒳 = [x; v], 4 × particles, in µm and µm/µs; the error is the
    spectral norm of the difference from the fixed point of constrained runs, which Newton finds to
    1e-11 µN. Elastic relaxation iterates with Ḟ = 0; its state then gets the velocities L x of
    (67). Its mean force is that without velocities, which the relaxation brings to zero.

    Args:
        limit: Euler steps of the first two.
        samples: iterations that are recorded, evenly spaced in the logarithm.
    """
    F, F_dot = steady_shear(SHEAR_RATE, shear)(0.0)
    unit = RveLaw(cell).unit_cell
    reference = _fixed_point(cell, F, F_dot)
    spaced = np.rint(np.geomspace(1.0, limit, samples)).astype(np.int64)
    counts = np.unique(np.concatenate([[0], spaced]))
    L = F_dot @ np.linalg.inv(F)

    def iterated(rate: Array) -> Relaxation:
        """The paper's iteration with this rate, interrupted at each of the counts."""
        drive, answer = Drive(pack(F[None]), pack(rate[None])), empty_answer(1)
        X, mass = unit.position.T, unit.neighbours.mass
        x, v = _tile(F @ X), _tile(rate @ X)
        forces, errors = [], []
        for count in np.diff(counts, prepend=0):
            stepping = Stepping(micro_step, _NEVER, int(count))
            iterate(drive, x, v, mass, unit.topology, unit.constants, stepping, answer)
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
    law = unit.topology, unit.constants
    rows: dict[int, tuple[float, float]] = {}
    for tolerance in np.geomspace(1e5, _REFERENCE_TOLERANCE, 65):
        z, answer = _tile(unit.position.T), empty_answer(1)
        factors = Factors.empty(drive, z, law[0])
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
FIGURE_6: tuple[Quantity[tuple[str, Relaxation]], ...] = (
    Quantity("method", "", "", lambda row: row[0]),
    Quantity("iterations to mean force 1", "", "d", lambda row: row[1].first_below(STOP)),
    Quantity("last iteration", "", "d", lambda row: int(row[1].iterations[-1])),
    Quantity("last mean force", "µN", ".3g", lambda row: float(row[1].mean_force[-1])),
    Quantity("last error", "µm and µm/µs", ".3g", lambda row: float(row[1].error[-1])),
)


def figure_6(setting: Setting) -> Study:
    """Error of the state at the left, mean force at the right."""
    solvers = relaxations(setting.of.cell)
    error, force = "error of the state / initial error", "mean particle force (µN)"

    def relative(way: Relaxation) -> Array:
        """The error over that with which all begin: a number, though x and v differ in unit."""
        return way.error / way.error[0]

    def panel(label: str, values: Callable[[Relaxation], Array]) -> Panel:
        curves = []
        for name, text in _LABELS.items():
            x, y = solvers[name].iterations.astype(float), values(solvers[name])
            curves.append(Curve(name, x, y, text, markers=name == DIRECT))
        ticks = (0, *(10**k for k in range(5)))
        names = tuple(f"{k:,}" for k in ticks)
        return Panel("iterations", label, tuple(curves), "", True, True, ticks, names)

    return Study(
        title="Figure 6: from the undeformed RVE to shear 0.1 at rate 0.01/µs",
        panels=(panel(error, relative), panel(force, lambda way: way.mean_force)),
        columns=2,
        table=Table(FIGURE_6, tuple(solvers.items())),
    )

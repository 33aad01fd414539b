"""Thin tissue by FE² with and without the surface law of its free sides, against the full tissue.

Strips of n plant cells across and 16 along are clamped at one end and pulled along their length by
a small body force; one of 4 across bends under its weight; the bar is the paper's, also of fewer
and more plant cells. FE² has true RVEs on the slow manifold, an element for each plant cell, at
most 16 each way, and oscillates about its state of rest by the stiffness and damping there: what it
does for small loads, in a second. A strip's period without the law gives c, the plant cells that
its sides take from its stiffness: c = n (1 − (FE²/tissue)²) of the periods.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache
from time import perf_counter
from typing import Any

import numpy as np

from surrofe2.displacement_curve import DisplacementCurve
from surrofe2.load_case import LoadCase
from surrofe2.macro import MacroSettings, Rest, Surface, find_rest
from surrofe2.macro.problem import bar
from surrofe2.macro.tangents import factorised, mass_matrix
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.damped_fit import DampedFit, fit_damped_modes
from surrofe2.report.figures import Curve, Panel
from surrofe2.report.study import NamedCell, Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.rve import RveLaw
from surrofe2.studies.bar_comparison import scaled_load_case
from surrofe2.studies.bar_runs import MICRO_STEP, TISSUE, Progress
from surrofe2.surface.cell_surface import CellSurface, table_within
from surrofe2.surface.slab_law import SlabLaw, rows_across
from surrofe2.tissue import TissueSettings, simulate_tissue

ALONG, MOST_ELEMENTS = 16, 16
SIZES = (2, 4, 8, 16)
BENT = 4
"""Plant cells across the cantilever."""
FE2, SURFACE = "slow-manifold", "with surface law"
METHODS = (TISSUE, FE2, SURFACE)
STRIP, CANTILEVER, BAR = "strip, pulled", "cantilever", "bar"
PULL, WEIGHT = 0.05, 0.005
"""µm/µs²: along the strips, and across the cantilever."""
PULLED, BENDING = 100.0, 400.0
"""µs."""
FREE_SIDES = ("top", "bottom", "right")
STRETCH, RATE = (0.96, 1.03), 0.008
"""Of the table of the surface law; beyond there are true slabs."""
STEPS = 8
"""Of small oscillations in an output interval: their period errs by 1e-4 of itself."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ThinCase:
    """A run of a strip, the cantilever or a bar of n plant cells across, by one of `METHODS`."""

    of: NamedCell
    shape: str
    across: int
    method: str

    @property
    def load_case(self) -> LoadCase:
        """What is clamped and what pulls."""
        if self.shape == BAR:
            return scaled_load_case(self.across)
        side, pulled = self.of.cell.cell_side, self.shape == STRIP
        width, height = ALONG * side, self.across * side
        return LoadCase(
            width=width,
            height=height,
            body_force=(PULL, 0.0) if pulled else (0.0, -WEIGHT),
            duration=PULLED if pulled else BENDING,
            watched=(width, 0.5 * height),
        )

    @property
    def elements(self) -> tuple[int, int]:
        """In x and y."""
        across = min(self.across, MOST_ELEMENTS)
        return (across if self.shape == BAR else ALONG), across

    @property
    def name(self) -> str:
        """Stem of its file."""
        shape = self.shape.split(",")[0]
        return f"{self.of.name}-{shape}-{self.across}-{self.method.replace(' ', '-')}"

    @property
    def label(self) -> str:
        """What progress calls it."""
        return f"{self.shape}, {self.across} plant cells across, {self.method}"

    @property
    def duration(self) -> float:
        """Length of the run, µs."""
        return self.load_case.duration

    def configuration(self) -> dict[str, Any]:
        """Everything the curve depends on, by name."""
        found = {
            "cell": self.of.cell.to_dict(),
            "load": asdict(self.load_case),
            "method": self.method,
        }
        if self.method == TISSUE:
            return found | {"micro_step": MICRO_STEP}
        return found | {
            "elements": self.elements,
            "steps": STEPS,
        }

    def compute(self, progress: Progress | None = None) -> ThinRun:
        """Make the run, by FE² or as a full tissue."""
        cell, load_case = self.of.cell, self.load_case
        law = RveLaw(cell, initialisation=FE2)
        if self.method == TISSUE:
            settings = TissueSettings(micro_step=MICRO_STEP, frames=2)
            done = simulate_tissue(
                load_case, cell, settings, reference=law.reference, progress=progress
            )
            return ThinRun(self, done.curve, done.wall_time["total"])
        problem = bar(load_case, self.elements)
        if self.method == SURFACE:
            surface = Surface(law=surface_of(cell, rows_across(self.across)), on=FREE_SIDES)
            problem = replace(problem, surface=surface)
        begun = perf_counter()
        rest = find_rest(problem, law, MacroSettings(elements=self.elements), factor=0.0)
        curve = small_oscillations(rest, load_case)
        return ThinRun(self, curve, perf_counter() - begun)

    def run(self, curve: DisplacementCurve, seconds: float) -> ThinRun:
        """The run of a kept curve."""
        return ThinRun(self, curve, seconds)


def small_oscillations(rest: Rest, load_case: LoadCase) -> DisplacementCurve:
    """M ü + C u̇ + K u = l about a rest, l the body force from t = 0 on, by the trapezoidal rule."""
    system, t = rest.system, load_case.output_times()
    step = (t[1] - t[0]) / STEPS
    mass, damping, stiffness = mass_matrix(system), rest.damping, rest.stiffness
    load = system.pick(system.mass @ np.tile(load_case.body_force, (system.n_rows, 1)))
    solve = factorised((4.0 / step**2 * mass + 2.0 / step * damping + stiffness).tocsc())
    assert solve is not None
    nodes, weights = system.watched[0]
    u, v, rows = np.zeros_like(load), np.zeros_like(load), np.zeros(2 * system.n_rows)
    a = np.asarray(system.solve_mass(load))
    seen = np.zeros((len(t), 2))
    for k in range(1, len(t)):
        for _ in range(STEPS):
            inert = 4.0 / step * (u / step + v) + a
            after = solve(load + mass @ inert + damping @ (2.0 / step * u + v))
            rate = 2.0 / step * (after - u) - v
            a = 2.0 / step * (rate - v) - a
            u, v = after, rate
        rows[system.free] = u
        seen[k] = weights @ rows.reshape(-1, 2)[nodes]
    return DisplacementCurve(t, seen)


@lru_cache(maxsize=4)
def surface_of(cell: CellParameters, rows: int) -> CellSurface:
    """The surface law of a plant cell on the slow manifold by slabs of so many rows."""
    slab = SlabLaw(cell, initialisation=FE2, rows=rows)
    return CellSurface(table_within(slab, STRETCH, RATE), rows, lambda: slab)


@dataclass(frozen=True, eq=False)
class ThinRun:
    """A run: displacement of the middle of the free end, and the wall time in s."""

    case: ThinCase
    curve: DisplacementCurve
    seconds: float

    @property
    def values(self) -> Any:
        """(m,) along the load, µm."""
        return self.curve.displacement[:, 0 if self.case.shape == STRIP else 1]

    @cached_property
    def fit(self) -> DampedFit:
        """Two damped modes."""
        return fit_damped_modes(self.curve.t, self.values, 2)

    @property
    def measures(self) -> dict[str, float]:
        """What is compared, by its name with the unit."""
        first = self.fit.first
        return {"period (µs)": first.period, "decrement": first.decrement}


@dataclass(frozen=True, slots=True)
class Compared:
    """A measure by all of `METHODS`, and their wall times, s."""

    case: ThinCase
    measure: str
    values: tuple[float, ...]
    seconds: tuple[float, ...]

    def off(self, k: int) -> float:
        """Method k over the tissue − 1, %."""
        return 100.0 * (self.values[k] / self.values[0] - 1.0)

    @property
    def c(self) -> float | None:
        """Plant cells that the sides of a strip take from its stiffness."""
        if self.case.shape != STRIP or not self.measure.startswith("period"):
            return None
        return self.case.across * (1.0 - (self.values[1] / self.values[0]) ** 2)


ROWS: tuple[Quantity[Compared], ...] = (
    Quantity("problem", "", "", lambda row: row.case.shape),
    Quantity("plant cells across", "", "d", lambda row: row.case.across),
    Quantity("measure", "", "", lambda row: row.measure),
    Quantity("full tissue", "", ".5g", lambda row: row.values[0]),
    Quantity("FE²", "", ".5g", lambda row: row.values[1]),
    Quantity("with surface law", "", ".5g", lambda row: row.values[2]),
    Quantity("FE² off", "%", "+.2f", lambda row: row.off(1)),
    Quantity("with surface law off", "%", "+.2f", lambda row: row.off(2)),
    Quantity("c", "plant cells", ".3f", lambda row: row.c),
    Quantity("tissue's time", "s", ".1f", lambda row: row.seconds[0]),
    Quantity("time with surface law", "s", ".1f", lambda row: row.seconds[2]),
)


def thin_cases(
    of: NamedCell, sizes: Sequence[int] = SIZES, bars: Sequence[int] = ()
) -> list[ThinCase]:
    """Each strip, the cantilever and bars of so many plant cells, by all methods."""
    shapes = [(STRIP, n) for n in sizes] + [(CANTILEVER, BENT)] + [(BAR, n) for n in bars]
    return [
        ThinCase(of=of, shape=shape, across=n, method=method)
        for shape, n in shapes
        for method in METHODS
    ]


def thin_tissue(runs: Sequence[ThinRun]) -> Study:
    """How far FE² is from the tissue with and without the surface law."""
    groups = [runs[k : k + len(METHODS)] for k in range(0, len(runs), len(METHODS))]
    rows = [
        Compared(
            group[0].case,
            name,
            tuple(run.measures[name] for run in group),
            tuple(run.seconds for run in group),
        )
        for group in groups
        for name in group[0].measures
    ]
    drawn: dict[str, Sequence[ThinRun]] = {}
    for group in groups:
        drawn.setdefault(group[0].case.shape, group)
    return Study(
        title="Thin tissue: FE² with and without the surface law of its free sides",
        panels=(_periods(rows), *(_curves(group) for group in drawn.values())),
        columns=2,
        table=Table(ROWS, rows),
    )


def _periods(rows: Sequence[Compared]) -> Panel:
    found = [row for row in rows if row.case.shape == STRIP and row.measure.startswith("period")]
    across = [float(row.case.across) for row in found]
    return Panel(
        title="axial mode of strips",
        x_label="plant cells across",
        y_label="period, over full tissue − 1 (%)",
        curves=tuple(
            Curve(METHODS[k], np.array(across), np.array([row.off(k) for row in found]))
            for k in (1, 2)
        ),
        log_x=True,
        x_ticks=tuple(across),
        zero=True,
    )


def _curves(group: Sequence[ThinRun]) -> Panel:
    case = group[0].case
    axis = "x" if case.shape == STRIP else "y"
    return Panel(
        title=f"{case.shape}, {case.across} plant cells across",
        x_label="time $t$ (µs)",
        y_label=f"displacement $u_{axis}$ of the end (µm)",
        curves=tuple(
            Curve(run.case.method, run.curve.t, run.values, markers=False) for run in group
        ),
    )

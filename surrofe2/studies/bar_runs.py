"""Runs of the bending bar that studies compare: what a run is of, and what its curve says."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from surrofe2.displacement_curve import DisplacementCurve
from surrofe2.io.kept import KeptCurve, KeptCurves
from surrofe2.load_case import LoadCase
from surrofe2.macro import MacroSettings, simulate
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.damped_fit import DampedFit, first_minimum, fit_damped_modes
from surrofe2.report.tables import Quantity
from surrofe2.rve import RveLaw
from surrofe2.tissue import TissueSettings, simulate_tissue

TISSUE = "tissue"
RELATIVE_TOLERANCE, ABSOLUTE_TOLERANCE = 1e-5, 1e-7
"""Of the macro runs. At the paper's 1e-3 and 1e-5 the minimum differs by 1e-4 µm, the period by
1e-6 and the decrement by 1e-5 of itself: stability sets the step. What the fit leaves (0.08 µm at
most, `water` on 4 × 4) is third and higher modes in the first microseconds."""
MICRO_STEP = 2e-3
"""Of the full tissue, µs."""

Progress = Callable[[float, float], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class BarCase:
    """A run of the bar that is to be made.

    Attributes:
        method: an initialisation, or "tissue" with no elements.
        tolerance_factor: of the macro run's tolerances.
        micro_step: of the tissue, µs.
    """

    cell: CellParameters
    preset: str
    method: str
    load_case: LoadCase = field(default_factory=LoadCase)
    elements: tuple[int, int] | None = None
    tolerance_factor: float = 1.0
    micro_step: float = MICRO_STEP

    @property
    def plant_cells(self) -> tuple[int, int]:
        """In x and y."""
        side = self.cell.cell_side
        return round(self.load_case.width / side), round(self.load_case.height / side)

    @property
    def name(self) -> str:
        """Stem of its file."""
        n, m = self.plant_cells
        mesh = "" if self.elements is None else f"-on-{self.elements[0]}x{self.elements[1]}"
        return f"{self.preset}-{n}x{m}-{self.method}{mesh}"

    @property
    def label(self) -> str:
        """What progress and tables call it."""
        n, m = self.plant_cells
        if self.elements is None:
            return f"tissue of {n}x{m}, step {self.micro_step:g} µs"
        tighter = "" if self.tolerance_factor == 1.0 else f", tolerances x {self.tolerance_factor}"
        return f"{self.method} on {self.elements[0]}x{self.elements[1]} for {n}x{m}{tighter}"

    @property
    def tolerances(self) -> tuple[float, float]:
        """Relative, and absolute in µm and µm/µs."""
        factor = self.tolerance_factor
        return factor * RELATIVE_TOLERANCE, factor * ABSOLUTE_TOLERANCE

    def configuration(self) -> dict[str, Any]:
        """Everything the curve depends on, by name."""
        common = {"cell": self.cell.to_dict(), "load": asdict(self.load_case)}
        if self.elements is None:
            return common | {"method": TISSUE, "micro_step": self.micro_step}
        return common | {
            "method": self.method,
            "elements": self.elements,
            "tolerances": self.tolerances,
        }

    def compute(self, progress: Progress | None = None) -> BarRun:
        """Make the run, by FE² or as a full tissue."""
        if self.elements is None:
            reference = RveLaw(self.cell).reference
            settings = TissueSettings(micro_step=self.micro_step, frames=2)
            done = simulate_tissue(
                self.load_case, self.cell, settings, reference=reference, progress=progress
            )
            return make_bar_run(self, done.curve, done.wall_time["total"])
        relative, absolute = self.tolerances
        macro = MacroSettings(
            elements=self.elements,
            relative_tolerance=relative,
            absolute_tolerance=absolute,
            record_dissipation=False,
            frames=2,
        )
        law = RveLaw(self.cell, initialisation=self.method)
        run = simulate(self.load_case, law, macro, progress=progress)
        return make_bar_run(self, run.curve, run.wall_time["total"])


@dataclass(frozen=True, slots=True)
class BarRun:
    """What the curve of a run says.

    Attributes:
        curve: displacement of the watched point.
        minimum: time µs and depth µm of the first minimum.
        fit: two-mode fit of the vertical displacement.
        seconds: wall time.
    """

    case: BarCase
    curve: DisplacementCurve
    minimum: tuple[float, float]
    fit: DampedFit
    seconds: float

    @property
    def name(self) -> str:
        """How tables call it."""
        if self.case.elements is None:
            return "full tissue"
        return f"{self.case.method} {self.case.elements[0]}x{self.case.elements[1]}"


def make_bar_run(case: BarCase, curve: DisplacementCurve, seconds: float) -> BarRun:
    """Fit a curve."""
    u = curve.displacement[:, 1]
    return BarRun(case, curve, first_minimum(curve.t, u), fit_damped_modes(curve.t, u), seconds)


def compute_or_read(case: BarCase, kept: KeptCurves, progress: Progress | None = None) -> BarRun:
    """The run of a case: from its kept curve, or made and kept."""
    found = kept.read(case.name, case.configuration())
    if found is not None:
        return make_bar_run(case, found.curve, found.seconds)
    run = case.compute(progress)
    kept.write(case.name, case.configuration(), KeptCurve(run.curve, run.seconds))
    return run


COMPARED: tuple[Quantity[BarRun], ...] = (
    Quantity("first minimum", "µm", ".2f", lambda run: run.minimum[1]),
    Quantity("period", "µs", ".2f", lambda run: run.fit.first.period),
    Quantity("decrement", "", ".4f", lambda run: run.fit.first.decrement),
)
"""What bars are compared by."""


@dataclass(frozen=True, slots=True)
class ComparedBar:
    """A run, or with None what runs on finer and finer meshes tend to.

    off: how far it is from the full tissue of the same bar in `COMPARED`, run / tissue − 1 in % by
    name; empty for the tissue itself.
    """

    plant_cells: int
    run: BarRun | None
    off: Mapping[str, float]


def compare_bar(run: BarRun, tissue: BarRun | None) -> ComparedBar:
    """A run against the tissue, if there is one."""
    off = {}
    if tissue is not None and run is not tissue:
        off = {each.name: 100.0 * (each.get(run) / each.get(tissue) - 1.0) for each in COMPARED}
    return ComparedBar(run.case.plant_cells[0], run, off)


def of_run(
    name: str, unit: str, form: str | None, get: Callable[[BarRun], Any]
) -> Quantity[ComparedBar]:
    """A quantity of the run, where there is one."""
    return Quantity(name, unit, form, lambda row: None if row.run is None else get(row.run))


def deviation(name: str, form: str) -> Quantity[ComparedBar]:
    """One of `COMPARED` over the tissue's."""
    return Quantity(f"{name} off", "%", form, lambda row: row.off.get(name))

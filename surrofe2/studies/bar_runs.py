"""Runs of the bending bar that studies compare: what a run is of, and what its curve says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, Protocol, TypeVar

from surrofe2.displacement_curve import DisplacementCurve
from surrofe2.io.kept import KeptCurve, KeptCurves
from surrofe2.load_case import LoadCase
from surrofe2.macro import MacroSettings, simulate
from surrofe2.report.damped_fit import DampedFit, first_minimum, fit_damped_modes
from surrofe2.report.study import NamedCell
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

    of: NamedCell
    method: str
    load_case: LoadCase = field(default_factory=LoadCase)
    elements: tuple[int, int] | None = None
    tolerance_factor: float = 1.0
    micro_step: float = MICRO_STEP

    @property
    def plant_cells(self) -> tuple[int, int]:
        """In x and y."""
        side = self.of.cell.cell_side
        return round(self.load_case.width / side), round(self.load_case.height / side)

    @property
    def name(self) -> str:
        """Stem of its file."""
        n, m = self.plant_cells
        mesh = "" if self.elements is None else f"-on-{self.elements[0]}x{self.elements[1]}"
        return f"{self.of.name}-{n}x{m}-{self.method}{mesh}"

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

    @property
    def duration(self) -> float:
        """Length of the run, µs."""
        return self.load_case.duration

    def run(self, curve: DisplacementCurve, seconds: float) -> BarRun:
        """The run of a kept curve."""
        return BarRun(self, curve, seconds)

    def configuration(self) -> dict[str, Any]:
        """Everything the curve depends on, by name."""
        common = {
            "cell": self.of.cell.to_dict(),
            "load": asdict(self.load_case),
            "method": self.method,
        }
        if self.elements is None:
            return common | {"micro_step": self.micro_step}
        return common | {"elements": self.elements, "tolerances": self.tolerances}

    def compute(self, progress: Progress | None = None) -> BarRun:
        """Make the run, by FE² or as a full tissue."""
        cell, load_case = self.of.cell, self.load_case
        if self.elements is None:
            settings = TissueSettings(micro_step=self.micro_step, frames=2)
            reference = RveLaw(cell).reference
            done = simulate_tissue(
                load_case, cell, settings, reference=reference, progress=progress
            )
            return BarRun(self, done.curve, done.wall_time["total"])
        relative, absolute = self.tolerances
        macro = MacroSettings(
            elements=self.elements,
            relative_tolerance=relative,
            absolute_tolerance=absolute,
            record_dissipation=False,
            frames=2,
        )
        law = RveLaw(cell, initialisation=self.method)
        run = simulate(load_case, law, macro, progress=progress)
        return BarRun(self, run.curve, run.wall_time["total"])


@dataclass(frozen=True, slots=True)
class Way:
    """A way to fit: `modes` damped modes to the samples between two fractions of the curve."""

    name: str
    modes: int
    begin: float = 0.0
    end: float = 1.0

    def fit(self, curve: DisplacementCurve) -> DampedFit:
        """The fit of the vertical displacement."""
        span = curve.t[-1] - curve.t[0]
        within = (curve.t >= self.begin * span) & (curve.t <= self.end * span)
        return fit_damped_modes(curve.t[within], curve.displacement[within, 1], self.modes)


WAYS = (
    Way("two modes", 2),
    Way("three modes", 3),
    Way("four modes", 4),
    Way("two modes, last four fifths", 2, 0.2),
    Way("two modes, last three fifths", 2, 0.4),
    Way("two modes, first four fifths", 2, 0.0, 0.8),
)
"""The first is the one of the figures (docs/theory.md, period and decrement)."""


@dataclass(frozen=True, eq=False)
class BarRun:
    """A run: the displacement of the watched point and the wall time in s."""

    case: BarCase
    curve: DisplacementCurve
    seconds: float

    @cached_property
    def minimum(self) -> tuple[float, float]:
        """Time µs and depth µm of the first minimum."""
        return first_minimum(self.curve.t, self.curve.displacement[:, 1])

    @cached_property
    def fit(self) -> DampedFit:
        """By the first of `WAYS`."""
        return WAYS[0].fit(self.curve)

    @cached_property
    def fits(self) -> tuple[DampedFit, ...]:
        """By all of `WAYS`."""
        return self.fit, *(way.fit(self.curve) for way in WAYS[1:])

    @property
    def name(self) -> str:
        """How tables call it."""
        if self.case.elements is None:
            return "full tissue"
        return f"{self.case.method} {self.case.elements[0]}x{self.case.elements[1]}"


class Run(Protocol):
    """A run: a curve and its wall time in s."""

    @property
    def curve(self) -> DisplacementCurve: ...
    @property
    def seconds(self) -> float: ...


R_co = TypeVar("R_co", bound=Run, covariant=True)


class Case(Protocol[R_co]):
    """A run that is to be made; the names as of `BarCase`."""

    @property
    def name(self) -> str: ...
    @property
    def label(self) -> str: ...
    @property
    def duration(self) -> float: ...
    def configuration(self) -> dict[str, Any]: ...
    def compute(self, progress: Progress | None = None) -> R_co: ...
    def run(self, curve: DisplacementCurve, seconds: float) -> R_co: ...


def compute_or_read(case: Case[R_co], kept: KeptCurves, progress: Progress | None = None) -> R_co:
    """The run of a case: from its kept curve, or made and kept."""
    found = kept.read(case.name, case.configuration())
    if found is not None:
        return case.run(found.curve, found.seconds)
    run = case.compute(progress)
    kept.write(case.name, case.configuration(), KeptCurve(run.curve, run.seconds))
    return run

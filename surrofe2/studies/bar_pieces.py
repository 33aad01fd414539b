"""One run of the bar as a piece of a longer study: what it is of, and how it is computed."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from surrofe2.io.kept_curves import KeptCurve, KeptCurves
from surrofe2.load_case import LoadCase
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.studies.bar_comparison import (
    ABSOLUTE_TOLERANCE,
    RELATIVE_TOLERANCE,
    TISSUE,
    BarRun,
    Progress,
    make_bar_run,
    run_bar,
    run_tissue,
)

MICRO_STEP = 2e-3
"""Of the full tissue, µs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A run of the bar that has not been made yet.

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

    def configuration(self) -> dict[str, Any]:
        """Everything the curve depends on, by name."""
        common = {"cell": self.cell.to_dict(), "load": asdict(self.load_case)}
        if self.elements is None:
            return common | {"method": TISSUE, "micro_step": self.micro_step}
        relative, absolute = self.tolerances
        return common | {
            "method": self.method,
            "elements": self.elements,
            "relative_tolerance": relative,
            "absolute_tolerance": absolute,
        }

    @property
    def tolerances(self) -> tuple[float, float]:
        """Relative, and absolute in µm and µm/µs."""
        return (
            self.tolerance_factor * RELATIVE_TOLERANCE,
            self.tolerance_factor * ABSOLUTE_TOLERANCE,
        )

    def compute(self, progress: Progress | None = None) -> BarRun:
        """Make the run."""
        if self.elements is None:
            return run_tissue(
                self.cell, self.load_case, micro_step=self.micro_step, progress=progress
            )
        relative, absolute = self.tolerances
        return run_bar(
            self.cell,
            self.method,
            self.elements,
            self.load_case,
            relative_tolerance=relative,
            absolute_tolerance=absolute,
            progress=progress,
        )


def made(piece: Piece, kept: KeptCurves, progress: Progress | None = None) -> BarRun:
    """The run of a piece: from its kept curve, or made and kept."""
    found = kept.read(piece.name, piece.configuration())
    if found is not None:
        return make_bar_run(piece.method, piece.elements, found.curve, found.seconds)
    run = piece.compute(progress)
    kept.write(piece.name, piece.configuration(), KeptCurve(run.curve, run.seconds))
    return run

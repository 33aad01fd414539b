"""Problems other than the bar by FE² against the full tissue: strip, block between plates, skin.

A strip of 16 plant cells along and n across is pulled by 3 % and held; a block of as many is
pressed by 2 % between two plates; a cantilever twice as long as it is high, whose upper quarter has
walls half as stiff again, bends under a weight by which strains do not depend on its size. FE² has
true RVEs on the slow manifold. Forces are means over the last quarter, where the boundary rests.
What FE² is too stiff by is the surface's: c plant cells of n, so c = n (1 − tissue/FE²) does not
depend on n where nothing else is wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from surrofe2.displacement_curve import DisplacementCurve
from surrofe2.macro import simulate
from surrofe2.recipe import Recipe, make_recipe
from surrofe2.regional_law import RegionalLaw
from surrofe2.report.damped_fit import first_minimum, fit_damped_modes
from surrofe2.report.figures import Curve, Panel
from surrofe2.report.study import NamedCell, Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.rve import RveLaw
from surrofe2.studies.bar_runs import TISSUE, Progress
from surrofe2.tissue import simulate_tissue
from surrofe2.tissue_problem import cells_of, problem_of_tissue

ALONG, SKIN = 16, 4
"""Plant cells: length of strip and block; of the cantilever's height, as a quarter is skin."""
SIZES = (4, 8, 16, 24)
FE2 = "slow-manifold"
STIFFER = 1.5
"""Wall stiffness of the skin over that of the parenchyma."""
DURATION, RAMP, BENDING = 60.0, 45.0, 18.75
"""µs: strip and block, in which the boundary moves, and the cantilever per plant cell across."""
WEIGHT = 0.4
"""µm/µs² times plant cells across: acceleration of the cantilever."""
_STRIP, _BLOCK, _SKIN = "tensile strip", "block between plates", "skin over parenchyma"
_FORCES = {_STRIP: "grip", _BLOCK: "upper"}


@dataclass(frozen=True, slots=True, kw_only=True)
class ProblemCase:
    """A run of one of the problems, with n plant cells across, as a tissue or by FE²."""

    of: NamedCell
    problem: str
    across: int
    method: str

    @property
    def name(self) -> str:
        """Stem of its file."""
        return f"{self.of.name}-{self.problem.replace(' ', '-')}-{self.across}-{self.method}"

    @property
    def label(self) -> str:
        """What progress calls it."""
        return f"{self.problem}, {self.across} plant cells across, {self.method}"

    @property
    def duration(self) -> float:
        """Length of the run, µs."""
        return BENDING * self.across if self.problem == _SKIN else DURATION

    @property
    def recipe(self) -> Recipe:
        """The problem as a recipe states it."""
        side, n = self.of.cell.cell_side, self.across
        cell, long = self.of.cell.to_dict(), ALONG * side
        ramp = {"kind": "ramp", "end": RAMP, "smooth": True}
        table: dict[str, Any] = {
            "rve": {"initialisation": FE2},
            "macro": {"record_dissipation": False},
            "tissue": {"frames": 2},
            "time": {"duration": self.duration, "output_interval": 0.5, "frames": 2},
        }
        if self.problem == _SKIN:
            width, height = 2 * n * side, n * side
            skin = {**cell, "wall_stiffness": STIFFER * self.of.cell.wall_stiffness}
            table["cells"] = {
                "skin": {**skin, "regions": ["skin"]},
                "parenchyma": {**cell, "regions": ["rest"]},
            }
            table["mesh"] = {
                "width": width, "height": height, "elements": [16, 8],
                "regions": {"skin": {"box": [0.0, 0.75 * height, width, height]}},
            }  # fmt: skip
            table["conditions"] = {
                "clamp": {"kind": "fixed", "on": "left"},
                "weight": {"kind": "body_force", "acceleration": [0.0, -WEIGHT / n]},
            }
            table["watch"] = {"end": [width, 0.5 * height]}
            return make_recipe(table)
        table["cell"] = cell
        if self.problem == _STRIP:
            table["mesh"] = {
                "width": long, "height": n * side, "elements": [ALONG // 2, max(n // 2, 1)]
            }  # fmt: skip
            table["conditions"] = {
                "clamp": {"kind": "fixed", "on": "left"},
                "grip": {
                    "kind": "prescribed_motion", "on": "right", "amplitude": ramp,
                    "displacement": [0.03 * long, 0.0],
                },
            }  # fmt: skip
            return make_recipe(table)
        table["mesh"] = {
            "width": n * side, "height": long, "elements": [max(n // 2, 1), ALONG // 2]
        }  # fmt: skip
        table["bodies"] = {
            "lower": {"plane": {"normal": [0, 1]}, "on": "bottom", "position": [0, 0]},
            "upper": {
                "plane": {"normal": [0, -1]}, "on": "top", "position": [0, long],
                "displacement": [0.0, -0.02 * long], "amplitude": ramp,
            },
        }  # fmt: skip
        return make_recipe(table)

    def configuration(self) -> dict[str, Any]:
        """Everything the curve depends on, by name."""
        return {"recipe": self.recipe.to_dict(), "method": self.method}

    def compute(self, progress: Progress | None = None) -> ProblemRun:
        """Make the run: force on the boundary that moves, µN, or displacement of the end, µm."""
        recipe = self.recipe
        cells = cells_of(recipe)
        references = [RveLaw(cell).reference for cell in cells]
        if self.method == TISSUE:
            done = simulate_tissue(
                problem_of_tissue(recipe),
                cells,
                recipe.tissue,
                reference=references,
                progress=progress,
            )
            return self._run(done.curve, done.history, done.wall_time["total"])
        problem = recipe.problem()
        laws = {
            name: RveLaw(part.cell, part.rve, reference=reference)
            for (name, part), reference in zip(recipe.parts().items(), references, strict=True)
        }
        law = RegionalLaw(laws, recipe.points_of_cells(problem.mesh)) if recipe.types else laws[""]
        run = simulate(problem, law, recipe.macro, progress=progress)
        return self._run(run.curve, run.history, run.wall_time["total"])

    def run(self, curve: DisplacementCurve, seconds: float) -> ProblemRun:
        """The run of a kept curve."""
        return ProblemRun(self, curve, seconds)

    def _run(self, end: DisplacementCurve, history: Any, seconds: float) -> ProblemRun:
        name = _FORCES.get(self.problem)
        if name is None:
            return ProblemRun(self, end, seconds)
        force = np.stack([history[f"force {name} {axis}"] for axis in "xy"], axis=1)
        return ProblemRun(self, DisplacementCurve(end.t, force), seconds)


@dataclass(frozen=True, eq=False)
class ProblemRun:
    """A run: its curve in µN or µm, and the wall time in s."""

    case: ProblemCase
    curve: DisplacementCurve
    seconds: float

    @property
    def values(self) -> np.ndarray:
        """(m,) the component that counts."""
        return self.curve.displacement[:, 0 if self.case.problem == _STRIP else 1]

    def measures(self) -> dict[str, float]:
        """What is compared, by its name with the unit."""
        if self.case.problem == _SKIN:
            period = fit_damped_modes(self.curve.t, self.values, 2).first.period
            depth = first_minimum(self.curve.t, self.values)[1]
            return {"first minimum (µm)": depth, "period (µs)": period}
        return {"force (µN)": float(self.values[self.curve.t >= 0.75 * DURATION].mean())}


@dataclass(frozen=True, slots=True)
class Compared:
    """A measure of both runs of a problem, and their wall times, s."""

    case: ProblemCase
    measure: str
    tissue: float
    fe2: float
    seconds: tuple[float, float]

    @property
    def off(self) -> float:
        """FE² / tissue − 1, %."""
        return 100.0 * (self.fe2 / self.tissue - 1.0)

    @property
    def c(self) -> float | None:
        """Plant cells that the surface takes, of a force."""
        if self.case.problem == _SKIN:
            return None
        return self.case.across * (1.0 - self.tissue / self.fe2)


ROWS: tuple[Quantity[Compared], ...] = (
    Quantity("problem", "", "", lambda row: row.case.problem),
    Quantity("plant cells across", "", "d", lambda row: row.case.across),
    Quantity("measure", "", "", lambda row: row.measure),
    Quantity("full tissue", "", ".5g", lambda row: row.tissue),
    Quantity("FE²", "", ".5g", lambda row: row.fe2),
    Quantity("off", "%", "+.1f", lambda row: row.off),
    Quantity("c", "plant cells", ".2f", lambda row: row.c),
    Quantity("tissue's time", "s", ".1f", lambda row: row.seconds[0]),
    Quantity("FE²'s time", "s", ".1f", lambda row: row.seconds[1]),
)


def problem_cases(of: NamedCell, sizes: Sequence[int] = SIZES) -> list[ProblemCase]:
    """Both runs of strip and block at each size, and of the skin where it has whole rows."""
    found = [(name, n) for n in sizes for name in _FORCES]
    found += [(_SKIN, n) for n in sizes if n % SKIN == 0]
    return [
        ProblemCase(of=of, problem=name, across=n, method=method)
        for name, n in found
        for method in (TISSUE, FE2)
    ]


def problems(runs: Sequence[ProblemRun]) -> Study:
    """How far FE² is from the tissue in each problem."""
    pairs = list(zip(runs[::2], runs[1::2], strict=True))
    rows = [
        Compared(tissue.case, name, there, fe2.measures()[name], (tissue.seconds, fe2.seconds))
        for tissue, fe2 in pairs
        for name, there in tissue.measures().items()
    ]
    largest = {tissue.case.problem: (tissue, fe2) for tissue, fe2 in pairs}
    return Study(
        title="FE² against the full tissue: strip, plates and skin",
        panels=(_errors(rows), *(_curves(*pair) for pair in largest.values())),
        columns=2,
        table=Table(ROWS, rows),
    )


def _errors(rows: Sequence[Compared]) -> Panel:
    lines = []
    for name in _FORCES:
        found = [(float(row.case.across), row.off) for row in rows if row.case.problem == name]
        lines.append(Curve(name, *np.array(found).T))
    return Panel(
        x_label="plant cells across",
        y_label="force, FE² over tissue − 1 (%)",
        curves=tuple(lines),
        log_x=True,
        x_ticks=tuple(sorted({float(row.case.across) for row in rows})),
        zero=True,
    )


def _curves(tissue: ProblemRun, fe2: ProblemRun) -> Panel:
    bends = tissue.case.problem == _SKIN
    return Panel(
        title=f"{tissue.case.problem}, {tissue.case.across} plant cells across",
        x_label="time $t$ (µs)",
        y_label="displacement $u_y$ of the end (µm)" if bends else "force (µN)",
        curves=tuple(
            Curve(name, run.curve.t, run.values, markers=False)
            for name, run in ((TISSUE, tissue), (FE2, fe2))
        ),
    )

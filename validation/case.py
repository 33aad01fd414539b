"""One run of a problem by one method, its kept curve, how far it is from the full tissue; and what
a study is given."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import InputError
from surrofe2.base.kernel_cache import cache_folder
from surrofe2.macro import Rest, find_rest, simulate
from surrofe2.macro.equations_of_motion import factorised
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.problem import BodyForce, Surface
from surrofe2.recipe.recipe import CellStudy, Recipe, load_recipe, make_recipe
from surrofe2.report.study import NamedCell
from surrofe2.report.tables import Quantity
from surrofe2.run.charts import Curve, Panel
from surrofe2.rve import RveLaw
from surrofe2.store.store import plain, read_json, write_json
from surrofe2.surface.slab_law import SlabLaw, rows_across
from surrofe2.surface.tabulated import TabulatedSurface, table_within
from surrofe2.tissue import simulate_tissue
from surrofe2.workflow.laws import law_by_region
from surrofe2.workflow.tissue import tissue_of
from validation.damped_fit import DampedFit, first_minimum, fit_damped_modes
from validation.sketch import draw_sketch

Array = NDArray[np.float64]

TISSUE, FE2, SURFACE = "tissue", "slow-manifold", "with surface law"
"""Methods besides the other initialisations; the last is FE² whose free sides have a law, too."""
FREE_SIDES = ("top", "bottom", "right")
STRETCH, RATE = (0.96, 1.03), 0.008
"""Of the table of the surface law; beyond there are slabs of plant cells."""
STEPS = 8
"""Of small oscillations in an output interval: their period errs by 1e-4 of itself."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A run of a problem for a plant cell by a method.

    Attributes:
        problem: its name; runs of one problem and of as many plant cells across are compared.
        across: plant cells across what bends or is pulled.
        method: "tissue", an initialisation of FE², or "with surface law".
        table: the problem as the nested tables of a recipe, but for the cell where it has one.
        measures: names among `MEASURES` of what is compared.
        axis: component of what is watched, 0 or 1.
        force: name of the condition whose force is watched; None: the displacement.
        mean: name of the boundary whose mean displacement is watched; None: the watched point's.
        linear: FE² oscillates about its state of rest by the stiffness and damping there: what it
            does for small loads, in a second.
        even: whether the surface takes its plant cells evenly from the stiffness of the section.
        note: what tells the run from another of this method, such as its step.
    """

    problem: str
    of: NamedCell
    across: int
    method: str
    table: Mapping[str, Any] = field(repr=False)
    measures: tuple[str, ...]
    axis: int = 1
    force: str | None = None
    mean: str | None = None
    linear: bool = False
    even: bool = False
    note: str = ""

    @property
    def recipe(self) -> Recipe:
        """The problem as a recipe states it, by RVEs of this method."""
        cell = {} if "cells" in self.table else {"cell": self.of.cell.to_dict()}
        how = FE2 if self.method in (TISSUE, SURFACE) else self.method
        return make_recipe({**cell, "rve": {"initialisation": how}, **self.table})

    @property
    def elements(self) -> tuple[int, int] | None:
        """In x and y; None for a tissue."""
        section = self.table.get("mesh") or self.table.get("macro", {})
        return None if self.method == TISSUE else tuple(section["elements"])

    @property
    def run_name(self) -> str:
        """How tables and legends name the run."""
        if self.elements is None:
            return f"full tissue{self.note}"
        across, up = self.elements
        return f"{self.method.replace('-', ' ')}, {across} × {up} elements{self.note}"

    @property
    def name(self) -> str:
        """How progress names the run, and the stem of its file."""
        return f"{self.of.name}, {self.problem}, {self.across} plant cells across, {self.run_name}"

    def compute(self) -> Run:
        """Make the run."""
        recipe = self.recipe
        references = {
            name: RveLaw(cell.parameters).reference for name, cell in recipe.cells.items()
        }
        if self.method == TISSUE:
            tissue = tissue_of(recipe)
            run: Any = simulate_tissue(
                tissue.problem,
                tissue.cells,
                recipe.tissue,
                reference=list(references.values()),
                kind=tissue.kind,
            )
            return self._run(run)
        problem = recipe.problem()
        laws = {
            name: RveLaw(cell.parameters, recipe.rve, reference=references[name])
            for name, cell in recipe.cells.items()
        }
        law = law_by_region(recipe, problem.mesh, lambda study: laws[study.name])
        if self.method == SURFACE:
            skin = surface_of(self.of.cell, rows_across(self.across))
            problem = replace(problem, surface=Surface(law=skin, on=FREE_SIDES))
        if not self.linear:
            return self._run(simulate(problem, law, recipe.macro))
        begin = perf_counter()
        rest = find_rest(problem, law, recipe.macro, factor=0.0)
        t, load = problem.output_times(), problem.conditions[-1]
        assert isinstance(load, BodyForce)
        u = small_oscillations(rest, t, load.acceleration)
        return Run(self, t, u[:, self.axis], perf_counter() - begin)

    def _run(self, run: Any) -> Run:
        t, u, seconds = run.curve.t, run.curve.displacement[:, self.axis], run.wall_time["total"]
        if self.force is not None:
            u = run.history[f"force {self.force} {'xy'[self.axis]}"]
        elif self.mean is not None:
            u = run.history[f"mean displacement {self.mean} {'xy'[self.axis]}"]
        return Run(self, t, np.asarray(u), seconds)

    def compute_or_read(self, folder: Path) -> Run:
        """The run from its file in a folder, else computed and written there."""
        path = folder / f"{re.sub(r'[^0-9A-Za-z.]+', '-', self.name)}.json"
        made_by = {"recipe": self.recipe.to_dict(), "method": self.method, "linear": self.linear}
        made_by = plain({**made_by, "sources": cache_folder().name})
        stored = read_json(path) if path.exists() else {}
        if stored.get("made_by") == made_by:
            return Run(self, np.array(stored["t"]), np.array(stored["u"]), stored["seconds"])
        run = self.compute()
        result = {"t": run.t, "u": run.u, "seconds": run.seconds}
        write_json(path, {"made_by": made_by, **result})
        return run


@dataclass(frozen=True, eq=False)
class Run:
    """A run: t (m,) µs, what is watched u (m,) in µm or µN, and the wall time in s."""

    case: Case
    t: Array
    u: Array
    seconds: float

    @cached_property
    def fit(self) -> DampedFit:
        """Two damped modes."""
        return fit_damped_modes(self.t, self.u)


MEASURES: Mapping[str, tuple[str, Callable[[Run], float]]] = {
    "first minimum": ("µm", lambda run: first_minimum(run.t, run.u)[1]),
    "period": ("µs", lambda run: run.fit.first.period),
    "decrement": ("", lambda run: run.fit.first.decrement),
    "held force": ("µN", lambda run: float(run.u[run.t >= 0.75 * run.t[-1]].mean())),
}
"""What is read off a run, with its unit; the boundary that is pulled rests in the last quarter."""


@dataclass(frozen=True, slots=True)
class Row:
    """A measure of a run, or of the limit of its meshes, and of the full tissue where there is one.

    The surface takes c plant cells of n from the stiffness of a section, which is that of a force,
    or of the inverse square of a period: c = n (1 − tissue/FE²), and it does not depend on n where
    nothing else is wrong.
    """

    case: Case
    run_name: str
    measure: str
    value: float | None
    tissue: float | None
    off: float | None
    """Run / tissue − 1, %."""
    seconds: float | None

    @property
    def c(self) -> float | None:
        """Plant cells that the free sides take from a section that is pulled or pressed evenly."""
        if self.off is None or not self.case.even or self.case.method == SURFACE:
            return None
        ratio = 1.0 + self.off / 100.0
        stiffness = {"held force": ratio, "period": ratio**-2}.get(self.measure)
        return None if stiffness is None else self.case.across * (1.0 - 1.0 / stiffness)


ROWS: tuple[Quantity[Row], ...] = (
    Quantity("problem", "", "", lambda row: row.case.problem),
    Quantity("plant cells across", "", "d", lambda row: row.case.across),
    Quantity("run", "", "", lambda row: row.run_name),
    Quantity("measure", "µm, µs, µN", "", lambda row: row.measure),
    Quantity("value", "", ".5g", lambda row: row.value),
    Quantity("full tissue", "", ".5g", lambda row: row.tissue),
    Quantity("off", "%", "+.2f", lambda row: row.off),
    Quantity("c", "plant cells", ".3f", lambda row: row.c),
    Quantity("time", "s", ".1f", lambda row: row.seconds),
)


def compare(runs: Sequence[Run]) -> list[Row]:
    """Each measure of each run against the first tissue of the same problem and size, if any."""
    tissues: dict[tuple[str, int], Run] = {}
    for run in runs:
        if run.case.method == TISSUE:
            tissues.setdefault((run.case.problem, run.case.across), run)
    rows = []
    for run in runs:
        there = tissues.get((run.case.problem, run.case.across))
        for name in run.case.measures:
            _, get = MEASURES[name]
            value, true = get(run), None if there in (None, run) else get(there)
            off = None if true is None else 100.0 * (value / true - 1.0)
            rows.append(Row(run.case, run.case.run_name, name, value, true, off, run.seconds))
    return rows


def watched_of(case: Case) -> str:
    """What is watched, in words with its unit."""
    if case.force:
        return f"force at the {case.force} (µN)"
    return f"displacement $u_{'xy'[case.axis]}$ (µm)"


def curves_panel(runs: Iterable[Run], title: str, width: float = 1.0) -> Panel:
    """What is watched over time, a line for each run; `apart_panel` names the lines."""
    runs = list(runs)
    curves = (Curve(run.case.method, run.t, run.u, run.case.run_name, False) for run in runs)
    shown = watched_of(runs[0].case)
    return Panel("time (µs)", shown, tuple(curves), title, width=width, has_legend=False)


def apart_panel(
    runs: Iterable[Run],
    title: str,
    name: Callable[[Run], str] = lambda run: run.case.run_name,
    width: float = 1.0,
) -> Panel:
    """Each run minus the full tissue, which is the first of them, over time.

    Args:
        name: words for the legend.
    """
    first, *others = runs
    nothing = np.zeros(2)
    curves = [Curve(TISSUE, first.t[[0, -1]], nothing, name(first), False)]
    for run in others:
        apart = run.u - np.interp(run.t, first.t, first.u)
        curves.append(Curve(run.case.method, run.t, apart, name(run), False))
    unit = "µN" if first.case.force else "µm"
    return Panel("time (µs)", f"FE² − tissue ({unit})", tuple(curves), title, width=width)


def curves_of(runs: Sequence[Run], shown: Iterable[tuple[str, int]]) -> list[Panel]:
    """A panel with a legend for each (problem, plant cells across)."""
    panels = []
    for problem, n in shown:
        chosen = [run for run in runs if (run.case.problem, run.case.across) == (problem, n)]
        panel = curves_panel(chosen, f"{problem}, {n} plant cells across")
        panels.append(replace(panel, has_legend=True))
    return panels


def compared_panels(runs: Sequence[Run], problem: str, n: int) -> list[Panel]:
    """The sketch of a specimen, what is watched of it over time, and how far FE² is from it."""
    chosen = [run for run in runs if (run.case.problem, run.case.across) == (problem, n)]
    # the tissue first
    chosen.sort(key=lambda run: run.case.method != TISSUE)
    sketch = partial(draw_sketch, problem=chosen[0].case.recipe.problem())
    title = f"{problem}, {n} plant cells across"
    return [
        Panel("", "", (), title, width=0.7, sketch=sketch),
        curves_panel(chosen, "", width=0.85),
        apart_panel(chosen, "", width=0.85),
    ]


def off_panel(
    title: str,
    rows: Iterable[Row],
    measure: str,
    name: Callable[[Row], str] | None = None,
    width: float = 0.8,
) -> Panel:
    """Distance of a measure from the tissue over plant cells across, a line for each name."""
    lines: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        if row.measure == measure and row.off is not None:
            key = row.run_name if name is None else name(row)
            lines.setdefault(key, []).append((float(row.case.across), row.off))
    return Panel(
        title=title,
        x_label="plant cells across",
        y_label="FE² / tissue − 1 (%)",
        curves=tuple(
            Curve(key, x, y, key.replace("-", " "))
            for key, (x, y) in ((key, np.array(line).T) for key, line in lines.items())
        ),
        log_x=True,
        x_ticks=tuple(sorted({x for line in lines.values() for x, _ in line})),
        zero=True,
        width=width,
    )


def small_oscillations(rest: Rest, t: Array, body_force: tuple[float, float]) -> Array:
    """M ü + C u̇ + K u = l about a rest by the trapezoidal rule.

    Args:
        t: (m,) evenly spaced, µs.
        body_force: µm/µs², of l, from t = 0 on.

    Returns:
        (m, 2) displacement of the watched point, µm.
    """
    system = rest.system
    step = (t[1] - t[0]) / STEPS
    mass, damping, stiffness = system.free_mass, rest.damping, rest.stiffness
    load = system.pick(system.mass @ np.tile(body_force, system.n_rows))
    solve = factorised((4.0 / step**2 * mass + 2.0 / step * damping + stiffness).tocsc())
    assert solve is not None
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
        seen[k] = system.probes[0] @ rows.reshape(-1, 2)
    return seen


@lru_cache(maxsize=4)
def surface_of(cell: CellParameters, rows: int) -> TabulatedSurface:
    """The surface law of a plant cell on the slow manifold by slabs of so many rows."""
    slab = SlabLaw(cell, initialisation=FE2, rows=rows)
    return replace(table_within(slab, STRETCH, RATE), rows=rows, beyond=lambda: slab)


ROOT = Path(__file__).parents[1]
RECIPES = {"printed": "bending-bar.toml", "water": "bending-bar-water.toml"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """What a study is given.

    Attributes:
        of: the plant cell.
        out: folder of the study's files; `out`/curves keeps the curves of finished runs.
        sizes: plant cells across; None: as the study has it.
        meshes: elements per side; None: as the study has it.
        quick: less of ablation and worst-answer.
    """

    of: NamedCell
    out: Path
    sizes: tuple[int, ...] | None = None
    meshes: tuple[int, ...] | None = None
    quick: bool = False

    @property
    def asked(self) -> dict[str, Any]:
        """What the study's numbers depend on besides the cell."""
        return {"sizes": self.sizes, "meshes": self.meshes, "quick": self.quick}

    def study(self) -> CellStudy:
        """Return the study of the shipped recipe of the bar of this preset, its files in `out`.

        Raises:
            InputError: the plant cell has no shipped recipe.
        """
        if self.of.name not in RECIPES:
            raise InputError(f"--cell: {self.of.name}; it must be one of {', '.join(RECIPES)}")
        name = RECIPES[self.of.name]
        shipped = load_recipe(ROOT / "data" / name)
        cell = shipped.study().cell
        samples = cell.samples
        training = cell.training
        stem = Path(name).stem
        if self.quick:
            samples = replace(samples, count=2048)
            training = replace(training, iterations=60)
            stem += "-quick"
        return (
            replace(shipped, path=self.out / name)
            .study()
            .with_cell(
                samples=replace(samples, file=f"{stem}.h5"),
                training=training,
                training_file=f"{stem}-surrogate.h5",
            )
        )

    def runs(self, cases: Iterable[Case]) -> list[Run]:
        """The runs of all cases; those whose curves are kept are not computed again."""
        cases, runs = list(cases), []
        for k, case in enumerate(cases):
            print(f"{k + 1} of {len(cases)}: {case.name}", flush=True)
            runs.append(case.compute_or_read(self.out / "curves"))
        return runs

"""Bars by FE² against the full tissue: figure 8, growing bars, and what their damping depends on.

Growing bars (past the paper): a bar of n × n plant cells is 25 n µm wide, its body force
0.2 · 16/n µm/µs² and its times n/16 of those of 16 × 16, so that strains stay alike and only the
rates fall, with 1/n. What FE² gets wrong is of three kinds: the mesh (falls with the size of
elements), the finite size of plant cells (falls with 1/n), and the initialisation. From three
meshes, each with half the elements of the next, the first is taken out by Aitken's extrapolation.

Damping: the decrement is read off a curve by a least-squares fit, which has an error of its own:
more modes than two are in the curve, and the longest ones beat. So each curve is fitted in several
ways, and what they differ by is the uncertainty; the ratio to the tissue's decrement is taken way
by way, since what a way leaves out it leaves out of both.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from surrofe2.load_case import LoadCase
from surrofe2.report.figures import Curve, Panel
from surrofe2.report.study import NamedCell, Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.rve import INITIALISATIONS
from surrofe2.studies.bar_runs import MICRO_STEP, TISSUE, WAYS, BarCase, BarRun

DAMPING_METHODS = ("elastic", "constrained-runs", "slow-manifold")
GROWING_METHOD = "slow-manifold"
GROWING_SIZES = (8, 16, 32)
TIGHTER = 0.1
LIMIT = "mesh limit"


@dataclass(frozen=True, slots=True, kw_only=True)
class Bars:
    """What studies of whole bars are told.

    Attributes:
        meshes: elements a side of each.
        sizes: plant cells a side of each bar, where bars grow, or across of other problems; None:
            as those studies have it.
        tissue: whether figure 8 computes the full tissue too.
        duration: of a run of 16 × 16 plant cells, µs.
    """

    meshes: tuple[int, ...] = (4, 8, 16)
    sizes: tuple[int, ...] | None = None
    tissue: bool = True
    duration: float = 250.0


def scaled_load_case(n: int, duration: float = 250.0) -> LoadCase:
    """The paper's bar at n × n plant cells of 25 µm; `duration` is that at 16 × 16, µs."""
    side, scale = 25.0 * n, n / 16.0
    return LoadCase(
        width=side,
        height=side,
        body_force=(0.0, -0.2 / scale),
        duration=duration * scale,
        watched=(side, 0.5 * side),
        output_interval=0.5 * scale,
    )


def figure_8_cases(of: NamedCell, bars: Bars) -> list[BarCase]:
    """The full tissue, if wanted, and each initialisation on each mesh of n × n elements."""
    tissue = BarCase(of=of, method=TISSUE, load_case=LoadCase(duration=bars.duration))
    return [tissue] * bars.tissue + [
        replace(tissue, method=method, elements=(n, n))
        for n in bars.meshes
        for method in INITIALISATIONS
    ]


def growing_cases(of: NamedCell, bars: Bars) -> list[BarCase]:
    """The tissue and FE² on each mesh for each size, cheap ones first."""
    found = []
    for n in bars.sizes or GROWING_SIZES:
        tissue = BarCase(of=of, method=TISSUE, load_case=scaled_load_case(n, bars.duration))
        found.append(tissue)
        found += [replace(tissue, method=GROWING_METHOD, elements=(m, m)) for m in bars.meshes]
    return found


def damping_cases(of: NamedCell, bars: Bars) -> list[BarCase]:
    """The tissue at two steps; each method on each mesh; on all but the finest tolerances × 0.1."""
    tissue = BarCase(of=of, method=TISSUE, load_case=LoadCase(duration=bars.duration))
    found = [tissue, replace(tissue, micro_step=0.5 * MICRO_STEP)]
    for mesh in sorted(bars.meshes):
        for method in DAMPING_METHODS:
            case = replace(tissue, method=method, elements=(mesh, mesh))
            found.append(case)
            if mesh < max(bars.meshes) or len(bars.meshes) == 1:
                found.append(replace(case, tolerance_factor=TIGHTER))
    return found


@dataclass(frozen=True, slots=True)
class ComparedBar:
    """A run, or with None what runs on finer and finer meshes tend to.

    off: how far it is from the full tissue of the same bar, run / tissue − 1 in % by the name of a
    quantity; empty for the tissue itself, and where there is none.
    """

    plant_cells: int
    run: BarRun | None
    off: Mapping[str, float]

    @property
    def mesh(self) -> int:
        """Elements a side; 0 for the tissue and the limit."""
        return self.run.case.elements[0] if self.run and self.run.case.elements else 0


COMPARED: tuple[Quantity[BarRun], ...] = (
    Quantity("first minimum", "µm", ".2f", lambda run: run.minimum[1]),
    Quantity("period", "µs", ".2f", lambda run: run.fit.first.period),
    Quantity("decrement", "", ".4f", lambda run: run.fit.first.decrement),
)


def _decrement_of(k: int) -> Quantity[BarRun]:
    name = f"decrement, {WAYS[k].name}"
    return Quantity(name, "", None, lambda run: run.fits[k].first.decrement)


DECREMENTS = tuple(_decrement_of(k) for k in range(len(WAYS)))


def compare_bars(
    runs: Sequence[BarRun], compared: Sequence[Quantity[BarRun]] = COMPARED
) -> list[ComparedBar]:
    """Each run against the first full tissue of as many plant cells, if there is one."""
    tissues = {r.case.plant_cells: r for r in reversed(runs) if r.case.elements is None}
    rows = []
    for run in runs:
        there, off = tissues.get(run.case.plant_cells, run), {}
        if there is not run:
            off = {each.name: 100.0 * (each.get(run) / each.get(there) - 1.0) for each in compared}
        rows.append(ComparedBar(run.case.plant_cells[0], run, off))
    return rows


def with_limits(rows: Sequence[ComparedBar]) -> list[ComparedBar]:
    """The rows size by size, and at the end of each the limit of its meshes, if there is one."""
    found = []
    for n in dict.fromkeys(row.plant_cells for row in rows):
        of_size = [row for row in rows if row.plant_cells == n]
        finest = sorted((row for row in of_size if row.mesh), key=lambda row: row.mesh)[-3:]
        found += of_size
        if len(finest) == 3 and all(2 * a.mesh == b.mesh for a, b in pairwise(finest)):
            names = [each.name for each in COMPARED]
            limit = {name: aitken(*(row.off[name] for row in finest)) for name in names}
            found.append(ComparedBar(n, None, limit))
    return found


def aitken(a: float, b: float, c: float) -> float:
    """Limit of a geometric approach a, b, c, …; NaN where they do not approach one."""
    first, second = b - a, c - b
    if not 0.0 < second / first < 0.9 if first else True:
        return float("nan")
    return float(c + second**2 / (first - second))


def of_run(
    name: str, unit: str, form: str | None, get: Callable[[BarRun], Any]
) -> Quantity[ComparedBar]:
    """A quantity of the run, where there is one."""
    return Quantity(name, unit, form, lambda row: None if row.run is None else get(row.run))


def _off(name: str, form: str) -> Quantity[ComparedBar]:
    return Quantity(f"{name} off", "%", form, lambda row: row.off.get(name))


def _scaled(each: Quantity[BarRun]) -> Quantity[ComparedBar]:
    """Lengths and times for people, scaled to 16 × 16 plant cells."""
    name, form = f"{each.name} × 16/n" if each.unit else each.name, str(each.format)

    def get(run: BarRun) -> float:
        return each.get(run) * (16.0 / run.case.plant_cells[0] if each.unit else 1.0)

    return of_run(name, each.unit, form, get)


_RUN: Quantity[ComparedBar] = Quantity(
    "run", "", "", lambda row: row.run.name if row.run else LIMIT
)
FIGURE_8: tuple[Quantity[ComparedBar], ...] = (
    _RUN,
    *(
        quantity
        for each in COMPARED
        for quantity in (
            of_run(each.name, each.unit, str(each.format), each.get),
            _off(each.name, "+.1f"),
        )
    ),
    of_run("first minimum at", "µs", None, lambda run: run.minimum[0]),
    of_run("second period", "µs", None, lambda run: run.fit.second.period),
    of_run("fit residual", "µm", ".3f", lambda run: run.fit.residual),
    of_run("fit RMS", "µm", None, lambda run: run.fit.rms),
    of_run("time", "s", ".1f", lambda run: run.seconds),
)
GROWING: tuple[Quantity[ComparedBar], ...] = (
    Quantity("plant cells a side", "", "d", lambda row: row.plant_cells),
    _RUN,
    *(quantity for each in COMPARED for quantity in (_scaled(each), _off(each.name, "+.2f"))),
    of_run("first minimum", "µm", None, lambda run: run.minimum[1]),
    of_run("period", "µs", None, lambda run: run.fit.first.period),
    of_run("fit residual", "µm", None, lambda run: run.fit.residual),
    of_run("time", "s", ".0f", lambda run: run.seconds),
)


def _excesses(row: ComparedBar) -> list[float]:
    return [row.off.get(each.name, 0.0) for each in DECREMENTS]  # the tissue itself: 0


def _of_way(k: int) -> tuple[Quantity[ComparedBar], ...]:
    name = WAYS[k].name
    return (
        of_run(f"period, {name}", "µs", None, lambda run: run.fits[k].first.period),
        of_run(DECREMENTS[k].name, "", None, DECREMENTS[k].get),
        of_run(f"fit residual, {name}", "µm", None, lambda run: run.fits[k].residual),
    )


DAMPING: tuple[Quantity[ComparedBar], ...] = (
    of_run("run", "", "", lambda run: run.case.label),
    of_run("period", "µs", ".2f", lambda run: run.fit.first.period),
    of_run("decrement", "", ".4f", lambda run: run.fit.first.decrement),
    of_run("standard error", "", ".4f", lambda run: run.fit.decrement_error),
    of_run("lowest of all fits", "", ".4f", lambda run: min(each.get(run) for each in DECREMENTS)),
    of_run("highest of all fits", "", ".4f", lambda run: max(each.get(run) for each in DECREMENTS)),
    Quantity("excess over the tissue's", "%", "+.1f", lambda row: _excesses(row)[0]),
    Quantity("lowest excess", "%", "+.1f", lambda row: min(_excesses(row))),
    Quantity("highest excess", "%", "+.1f", lambda row: max(_excesses(row))),
    of_run("fit residual", "µm", ".3f", lambda run: run.fit.residual),
    *(quantity for k in range(len(WAYS)) for quantity in _of_way(k)),
)


def figure_8(runs: Sequence[BarRun]) -> Study:
    """One panel a mesh, the full tissue in each where there is one."""
    load_case = runs[-1].case.load_case
    there = any(run.case.elements is None for run in runs)
    missing = "" if there else "; full tissue not computed"
    size = f"{load_case.width:g} × {load_case.height:g} µm"
    return Study(
        title=f"Figure 8: bending bar of {size}{missing}",
        panels=tuple(
            Panel(
                title=f"FE² on {mesh[0]} × {mesh[1]} elements",
                x_label="time $t$ (µs)",
                y_label="displacement $u_y$ (µm)",
                curves=tuple(
                    Curve(
                        run.case.method,
                        run.curve.t,
                        run.curve.displacement[:, 1],
                        run.case.method if run.case.elements else run.name,
                        markers=False,
                    )
                    for run in runs
                    if run.case.elements in (None, mesh)
                ),
            )
            for mesh in sorted({run.case.elements for run in runs if run.case.elements})
        ),
        table=Table(FIGURE_8, compare_bars(runs)),
        series={
            "t (µs)": runs[0].curve.t,
            **{f"u_y {run.name} (µm)": run.curve.displacement[:, 1] for run in runs},
        },
        results={"full_tissue": "computed" if there else "not computed"},
    )


def growing_bars(runs: Sequence[BarRun]) -> Study:
    """Deviation of period, first minimum and decrement over the number of plant cells a side."""
    rows = with_limits(compare_bars(runs))

    def line(row: ComparedBar) -> str:
        return f"{row.mesh} × {row.mesh} elements" if row.mesh else LIMIT

    return Study(
        title="FE² against the full tissue as the bar grows\n(strains alike)",
        panels=tuple(
            _off_panel(
                f"{GROWING_METHOD}: {each.name}",
                "plant cells a side",
                "FE² over tissue − 1 (%)",
                [(line(row), row.plant_cells, row.off[each.name]) for row in rows if row.off],
            )
            for each in COMPARED
        ),
        columns=len(COMPARED),
        table=Table(GROWING, rows),
    )


def damping(runs: Sequence[BarRun]) -> Study:
    """Excess of the decrement over the tissue's for each run, with the spread over the fits."""
    rows = compare_bars(runs, DECREMENTS)
    drawn = [
        (row.run.case.method, row.mesh, _excesses(row)[0])
        for row in rows
        if row.run and row.mesh and row.run.case.tolerance_factor == 1.0
    ]
    label = "decrement over the tissue's − 1 (%)"
    return Study(
        title="Damping of the bar against the full tissue",
        panels=(_off_panel("", "elements a side", label, drawn),),
        table=Table(DAMPING, rows),
    )


def _off_panel(
    title: str, x_label: str, y_label: str, found: Sequence[tuple[str, int, float]]
) -> Panel:
    """A line for each name of (name, x, y)."""
    lines: dict[str, list[tuple[float, float]]] = {}
    for name, x, y in found:
        lines.setdefault(name, []).append((float(x), y))
    return Panel(
        title=title,
        x_label=x_label,
        y_label=y_label,
        curves=tuple(Curve(name, *np.array(points).T) for name, points in lines.items()),
        log_x=True,
        x_ticks=tuple(sorted({float(x) for _, x, _ in found})),
        zero=True,
    )

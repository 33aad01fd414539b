"""Figure 8: the bending bar by FE² with each initialisation, and by the full tissue."""

from __future__ import annotations

from collections.abc import Sequence

from surrofe2.load_case import LoadCase
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.figures import Curve, Panel
from surrofe2.report.study import Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.rve import INITIALISATIONS
from surrofe2.studies.bar_runs import (
    COMPARED,
    TISSUE,
    BarCase,
    BarRun,
    ComparedBar,
    compare_bar,
    deviation,
    of_run,
)


def cases(
    cell: CellParameters,
    preset: str,
    meshes: Sequence[int] = (4, 8),
    duration: float = 250.0,
    *,
    tissue: bool = True,
) -> list[BarCase]:
    """The full tissue, if wanted, and each initialisation on each mesh of n × n elements."""
    load_case = LoadCase(duration=duration)
    found = [BarCase(cell=cell, preset=preset, method=TISSUE, load_case=load_case)]
    found += [
        BarCase(cell=cell, preset=preset, method=method, load_case=load_case, elements=(n, n))
        for n in meshes
        for method in INITIALISATIONS
    ]
    return found if tissue else found[1:]


QUANTITIES: tuple[Quantity[ComparedBar], ...] = (
    of_run("run", "", "", lambda run: run.name),
    *(
        quantity
        for each in COMPARED
        for quantity in (
            of_run(each.name, each.unit, str(each.format), each.get),
            deviation(each.name, "+.1f"),
        )
    ),
    of_run("first minimum at", "µs", None, lambda run: run.minimum[0]),
    of_run("second period", "µs", None, lambda run: run.fit.second.period),
    of_run("fit residual", "µm", ".3f", lambda run: run.fit.residual),
    of_run("fit RMS", "µm", None, lambda run: run.fit.rms),
    of_run("time", "s", ".1f", lambda run: run.seconds),
)


def describe(runs: Sequence[BarRun]) -> Study:
    """One panel a mesh, the full tissue in each where there is one."""
    tissue = next((run for run in runs if run.case.elements is None), None)
    meshes = sorted({run.case.elements for run in runs if run.case.elements is not None})
    case = runs[-1].case
    size = f"{case.load_case.width:g} × {case.load_case.height:g} µm"
    missing = "" if tissue else "; full tissue not computed"
    return Study(
        name=f"fig8-{case.preset}",
        title=f"Figure 8: bending bar of {size}, preset “{case.preset}”{missing}",
        panels=tuple(_panel(mesh, runs) for mesh in meshes),
        table=Table(QUANTITIES, [compare_bar(run, tissue) for run in runs]),
        series={
            "t (µs)": runs[0].curve.t,
            **{f"u_y {run.name} (µm)": run.curve.displacement[:, 1] for run in runs},
        },
        results={"full_tissue": "computed" if tissue else "not computed"},
    )


def _panel(mesh: tuple[int, int], runs: Sequence[BarRun]) -> Panel:
    return Panel(
        title=f"FE² on {mesh[0]} × {mesh[1]} elements",
        x_label="time $t$ (µs)",
        y_label="displacement $u_y$ (µm)",
        curves=tuple(
            Curve(
                run.case.method,
                run.curve.t,
                run.curve.displacement[:, 1],
                run.name if run.case.elements is None else run.case.method,
                markers=False,
            )
            for run in runs
            if run.case.elements in (None, mesh)
        ),
    )

"""The paper's figures and further studies; those of whole bars keep their curves one by one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from surrofe2.io.kept import KeptCurves
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.study import NamedCell, Study, keep_study
from surrofe2.studies import (
    bar_comparison,
    initialisations,
    memory,
    relaxation,
    stability,
    thin_tissue,
    tissue_problems,
)
from surrofe2.studies.bar_comparison import Bars
from surrofe2.studies.bar_runs import BarCase, BarRun, Case, R_co, compute_or_read
from surrofe2.workflow.run_lifecycle import Report, Stage, silent

CURVES = "curves"
Progress = Callable[[float], None]


def _figure_5(cell: CellParameters, progress: Progress) -> Study:
    return initialisations.figure_5([initialisations.shear_steps(cell, r) for r in (0.0, 0.01)])


def _figure_6(cell: CellParameters, progress: Progress) -> Study:
    return relaxation.describe(relaxation.relaxations(cell))


def _rates(cell: CellParameters, progress: Progress) -> Study:
    found = initialisations.rate_errors(cell, progress=progress)
    return initialisations.orders_in_the_rate(found)


def _stability(cell: CellParameters, progress: Progress) -> Study:
    return stability.describe(stability.stability_map(cell, progress=progress))


OF_AN_RVE: Mapping[str, Callable[[CellParameters, Progress], Study]] = {
    "fig5": _figure_5,
    "fig6": _figure_6,
    "rates": _rates,
    "stability": _stability,
}
PROBLEMS, THIN, MEMORY = "problems", "thin", "memory"
Cases = Callable[[NamedCell, Bars], list[BarCase]]
OF_BARS: Mapping[str, tuple[Cases, Callable[[Sequence[BarRun]], Study], tuple[str, ...]]] = {
    "fig8": (bar_comparison.figure_8_cases, bar_comparison.figure_8, ("tissue",)),
    "scales": (bar_comparison.growing_cases, bar_comparison.growing_bars, ("sizes",)),
    "damping": (bar_comparison.damping_cases, bar_comparison.damping, ()),
}
"""The runs, what is made of them, and what they depend on besides meshes and duration."""


def reproduce_figure(
    figure: str,
    of: NamedCell,
    out: Path,
    bars: Bars,
    *,
    fresh: bool = False,
    stage: Stage = silent,
) -> tuple[Study | None, list[Path]]:
    """Compute a figure and write its files; (the study, or None where it was there, its files).

    Raises:
        MismatchError: `out` holds the figure by other settings, and not `fresh`.
    """
    if figure in OF_AN_RVE:

        def compute() -> Study:
            with stage(figure, 1.0, "parts") as report:
                return OF_AN_RVE[figure](of.cell, lambda done: report(done, ""))

        return keep_study(out, figure, of, {}, compute, fresh=fresh)
    if figure == MEMORY:
        wanted = memory.MemorySettings(period=bars.duration)

        def remember() -> Study:
            with stage(figure, 1.0, "parts") as report:
                found = memory.memory(of.cell, wanted, progress=lambda done: report(done, ""))
            return memory.describe(found)

        return keep_study(out, figure, of, asdict(wanted), remember, fresh=fresh)
    if figure == PROBLEMS:
        sizes = tissue_problems.SIZES if bars.sizes is None else bars.sizes

        def compare() -> Study:
            cases = tissue_problems.problem_cases(of, sizes)
            return tissue_problems.problems(compute_all(cases, KeptCurves(out / CURVES), stage))

        return keep_study(out, figure, of, {"sizes": sizes}, compare, fresh=fresh)
    if figure == THIN:
        across = thin_tissue.SIZES if bars.sizes is None else bars.sizes
        told = {"sizes": across, "bars": bars.meshes}

        def thin() -> Study:
            cases = thin_tissue.thin_cases(of, across, bars.meshes)
            return thin_tissue.thin_tissue(compute_all(cases, KeptCurves(out / CURVES), stage))

        return keep_study(out, figure, of, told, thin, fresh=fresh)
    cases, describe, depends = OF_BARS[figure]
    names = {"meshes", "duration", *depends}
    asked = {name: value for name, value in asdict(bars).items() if name in names}

    def make() -> Study:
        return describe(compute_all(cases(of, bars), KeptCurves(out / CURVES), stage))

    return keep_study(out, figure, of, asked, make, fresh=fresh)


def compute_all(cases: Sequence[Case[R_co]], kept: KeptCurves, stage: Stage = silent) -> list[R_co]:
    """The runs of all cases; those whose curves are kept are not computed again."""
    runs = []
    for k, case in enumerate(cases):
        label = f"{k + 1} of {len(cases)}: {case.label}"
        with stage(label, case.duration, "µs") as report:
            runs.append(compute_or_read(case, kept, _reporting(report)))
    return runs


def _reporting(report: Report) -> Callable[[float, float], None]:
    return lambda t, duration: report(t, "")

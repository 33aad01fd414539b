"""The paper's figures and further studies of whole bars, whose curves are kept one by one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from surrofe2.io.kept import KeptCurves
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.study import Study, study_is_there, study_paths, write_study
from surrofe2.studies import (
    bar_comparison,
    damping,
    initialisation_errors,
    relaxation,
    scale_separation,
    shear_steps,
    stability,
)
from surrofe2.studies.bar_runs import BarCase, BarRun, compute_or_read
from surrofe2.workflow.run_lifecycle import Report, Stage, silent

CURVES = "curves"


@dataclass(frozen=True, slots=True, kw_only=True)
class Bars:
    """What studies of whole bars are told.

    Attributes:
        meshes: elements a side of each; empty: those of the study.
        sizes: plant cells a side of each bar, for scales.
        tissue: whether fig8 computes the full tissue too.
        duration: of a run of 16 × 16 plant cells, µs.
    """

    meshes: tuple[int, ...] = ()
    sizes: tuple[int, ...] = (8, 16, 32)
    tissue: bool = True
    duration: float = 250.0

    def asked(self, figure: str) -> dict[str, Any]:
        """What a figure depends on, by name."""
        common = {"meshes": self.meshes_of(figure), "duration": self.duration}
        return {
            "fig8": common | {"tissue": self.tissue},
            "scales": common | {"sizes": self.sizes},
            "damping": common,
        }.get(figure, {})

    def meshes_of(self, figure: str) -> tuple[int, ...]:
        """The meshes of a figure."""
        return self.meshes or ((4, 8) if figure == "fig8" else (4, 8, 16))


def reproduce_figure(
    figure: str,
    preset: str,
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
    name, cell, asked = f"{figure}-{preset}", CellParameters.preset(preset), bars.asked(figure)
    if not fresh and study_is_there(out, name, cell, preset, asked):
        return None, study_paths(out, name)
    if figure in ("fig8", "scales", "damping"):
        study = _of_bars(figure, cell, preset, bars, KeptCurves(out / CURVES), stage)
    else:
        study = _of_an_rve(figure, cell, preset, stage)
    return study, write_study(out, study, cell, preset, asked)


def _of_an_rve(figure: str, cell: CellParameters, preset: str, stage: Stage) -> Study:
    if figure == "fig5":
        runs = tuple(shear_steps.shear_steps(cell, rate) for rate in (0.0, 0.01))
        return shear_steps.describe(runs, preset)
    if figure == "fig6":
        return relaxation.describe(relaxation.relaxations(cell), preset)
    with stage(figure, 1.0, "parts") as report:
        if figure == "stability":
            found = stability.stability_map(cell, progress=lambda done: report(done, ""))
            return stability.describe(found, preset)
        errors = initialisation_errors.initialisation_errors(
            cell, progress=lambda done: report(done, "")
        )
    return initialisation_errors.describe(errors, preset)


def _of_bars(
    figure: str, cell: CellParameters, preset: str, bars: Bars, kept: KeptCurves, stage: Stage
) -> Study:
    meshes, duration = bars.meshes_of(figure), bars.duration
    if figure == "scales":
        cases = scale_separation.cases(cell, preset, bars.sizes, meshes, duration)
        return scale_separation.describe(compute_all(cases, kept, stage))
    if figure == "damping":
        cases = damping.cases(cell, preset, meshes, duration)
        return damping.describe(compute_all(cases, kept, stage))
    cases = bar_comparison.cases(cell, preset, meshes, duration, tissue=bars.tissue)
    return bar_comparison.describe(compute_all(cases, kept, stage))


def compute_all(cases: list[BarCase], kept: KeptCurves, stage: Stage = silent) -> list[BarRun]:
    """The runs of all cases; those whose curves are kept are not computed again."""
    runs = []
    for k, case in enumerate(cases):
        label = f"{k + 1} of {len(cases)}: {case.label}"
        with stage(label, case.load_case.duration, "µs") as report:
            runs.append(compute_or_read(case, kept, _reporting(report)))
    return runs


def _reporting(report: Report) -> Callable[[float, float], None]:
    return lambda t, duration: report(t, "")

"""The paper's figures and further studies of whole bars, whose curves are kept one by one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from surrofe2.io.kept_curves import KeptCurves
from surrofe2.load_case import LoadCase
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.study import Study
from surrofe2.report.study_files import study_is_there, study_paths, write_study
from surrofe2.rve import INITIALISATIONS
from surrofe2.studies import (
    bar_comparison,
    damping,
    initialisation_errors,
    relaxation,
    shear_steps,
    stability,
)
from surrofe2.studies import scale_separation as scales
from surrofe2.studies.bar_comparison import ABSOLUTE_TOLERANCE, RELATIVE_TOLERANCE, TISSUE, BarRun
from surrofe2.studies.bar_pieces import Piece, made
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
        kept = KeptCurves(out / CURVES)
        study = _of_bars(figure, cell, preset, name, bars, kept, stage)
    else:
        study = _of_an_rve(figure, cell, preset, name, stage)
    return study, write_study(out, study, cell, preset, asked)


def _of_an_rve(figure: str, cell: CellParameters, preset: str, name: str, stage: Stage) -> Study:
    if figure == "fig5":
        runs = tuple(shear_steps.shear_steps(cell, rate) for rate in (0.0, 0.01))
        return shear_steps.describe(runs, preset, name)
    if figure == "fig6":
        return relaxation.describe(relaxation.relaxations(cell), preset, name)
    with stage(figure, 1.0, "parts") as report:
        if figure == "stability":
            found = stability.stability_map(cell, progress=lambda done: report(done, ""))
            onset = {way: "–" if s is None else f"{s:.4f}" for way, s in found.onset.items()}
            study = stability.describe(found, preset, name)
            return _with_table(study, "way", "largest |F - I| that is stable", onset)
        errors = initialisation_errors.initialisation_errors(
            cell, progress=lambda done: report(done, "")
        )
    order = {method: f"{value:.3f}" for method, value in errors.order.items()}
    study = initialisation_errors.describe(errors, preset, name)
    return _with_table(study, "initialisation", "order of the error in the rate", order)


def _with_table(study: Study, key: str, value: str, rows: Mapping[str, str]) -> Study:
    return replace(study, shown={key: list(rows), value: list(rows.values())})


def _of_bars(
    figure: str,
    cell: CellParameters,
    preset: str,
    name: str,
    bars: Bars,
    kept: KeptCurves,
    stage: Stage,
) -> Study:
    meshes, duration = bars.meshes_of(figure), bars.duration
    if figure == "scales":
        planned = scales.pieces(cell, preset, bars.sizes, meshes, duration=duration)
        runs = make_all([piece for _, piece in planned], kept, stage)
        of_size: dict[int, list[BarRun]] = {n: [] for n in bars.sizes}
        for (n, _), run in zip(planned, runs, strict=True):
            of_size[n].append(run)
        rows = scales.deviations(of_size)
        told = {"sizes": bars.sizes, "meshes": meshes, "duration": duration}
        return scales.describe(rows, preset, name, **told)
    if figure == "damping":
        pieces = damping.pieces(cell, preset, meshes, duration)
        runs = make_all(pieces, kept, stage)
        found = damping.dampings(list(zip(pieces, runs, strict=True)))
        return damping.describe(found, preset, name, meshes=meshes, duration=duration)
    load = LoadCase(duration=duration)
    pieces = [Piece(cell=cell, preset=preset, method=TISSUE, load_case=load)] * bars.tissue
    pieces += [
        Piece(cell=cell, preset=preset, method=method, load_case=load, elements=(n, n))
        for n in meshes
        for method in INITIALISATIONS
    ]
    return bar_comparison.describe(
        tuple(make_all(pieces, kept, stage)),
        load,
        preset,
        name,
        relative_tolerance=RELATIVE_TOLERANCE,
        absolute_tolerance=ABSOLUTE_TOLERANCE,
        duration=duration,
    )


def make_all(pieces: list[Piece], kept: KeptCurves, stage: Stage = silent) -> list[BarRun]:
    """The runs of all pieces; those whose curves are kept are not computed again."""
    runs = []
    for k, piece in enumerate(pieces):
        label = f"{k + 1} of {len(pieces)}: {piece.label}"
        with stage(label, piece.load_case.duration, "µs") as report:
            runs.append(made(piece, kept, _reporting(report)))
    return runs


def _reporting(report: Report) -> Callable[[float, float], None]:
    return lambda t, duration: report(t, "")

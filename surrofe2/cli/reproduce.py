"""`surrofe2 reproduce`: the paper's figures and the study of the initialisations' errors."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from surrofe2.cli.console import progress, say, show_table
from surrofe2.cli.options import Preset, ReplaceFiles, integers

if TYPE_CHECKING:
    from surrofe2.plant_cell.parameters import CellParameters
    from surrofe2.report.study import Study

Figure = Literal["fig5", "fig6", "fig8", "rates", "scales", "damping", "stability"]


def reproduce(
    figure: Annotated[Figure, typer.Argument(help="Which figure.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the figure's files.")],
    preset: Preset = "printed",
    meshes: Annotated[
        str | None,
        typer.Option(
            metavar="N,…",
            help="fig8, scales, damping: elements a side of each mesh; default 4,8 for fig8, "
            "else 4,8,16.",
        ),
    ] = None,
    sizes: Annotated[
        str, typer.Option(metavar="N,…", help="scales: plant cells a side of each bar.")
    ] = "8,16,32",
    tissue: Annotated[
        bool, typer.Option("--tissue/--no-tissue", help="fig8: the full tissue as well.")
    ] = True,
    duration: Annotated[
        float,
        typer.Option(metavar="µs", help="fig8, scales, damping: length of a run of 16 x 16 cells."),
    ] = 250.0,
    force: ReplaceFiles = False,
) -> None:
    """A figure of the paper, its data as CSV and its numbers as JSON.

    fig5: stress of one RVE over shear steps. fig6: mean force and error over iterations. fig8: the
    bending bar by FE² with each initialisation against the full tissue. rates: error of each
    initialisation against micro-integration as the rate goes down. scales: slow manifold against
    full tissues of 8 x 8, 16 x 16 and 32 x 32 plant cells. damping: decrements over mesh,
    tolerances, micro step and ways to fit. stability: where the plant cell has a stable
    equilibrium. The last four are not in the paper; scales and damping keep each run's curve in
    DIR/curves and take it from there when called again.

    Example: [bold]surrofe2 reproduce fig5 --preset water --out out/paper[/bold]

    Next: look at DIR/fig5-water.png; [bold]surrofe2 reproduce fig8[/bold] compares whole bars.
    """
    from surrofe2.cli.long_studies import damping_study, scales_study
    from surrofe2.plant_cell.parameters import CellParameters
    from surrofe2.report.study_files import check_free, write_study

    name = f"{figure}-{preset}"
    if not force:
        check_free(out, name)
    cell = CellParameters.preset(preset)
    mesh_numbers = integers("--meshes", meshes or ("4,8" if figure == "fig8" else "4,8,16"))
    if figure == "fig8":
        study = _bar(cell, preset, name, mesh_numbers, tissue, duration)
    elif figure == "scales":
        study = scales_study(
            cell, preset, name, out, integers("--sizes", sizes), mesh_numbers, duration
        )
    elif figure == "damping":
        study = damping_study(cell, preset, name, out, mesh_numbers, duration)
    else:
        study = _rve_figure(figure, cell, preset, name)
    if study.shown:
        rows = [list(row) for row in zip(*study.shown.values(), strict=True)]
        show_table(f"{name}: {' '.join(study.title.split())}", list(study.shown), rows)
    for path in write_study(out, study, cell, preset):
        say(str(path))


def _rve_figure(figure: str, cell: CellParameters, preset: str, name: str) -> Study:
    from surrofe2.studies import initialisation_errors, relaxation, shear_steps, stability

    if figure == "fig5":
        runs = tuple(shear_steps.shear_steps(cell, rate) for rate in (0.0, 0.01))
        return shear_steps.describe(runs, preset, name)
    if figure == "fig6":
        return relaxation.describe(relaxation.relaxations(cell), preset, name)
    if figure == "stability":
        with progress("stability", 1.0, "parts") as report:
            found = stability.stability_map(cell, progress=lambda done: report(done, ""))
        rows = [[way, "-" if s is None else f"{s:.4f}"] for way, s in found.onset.items()]
        show_table("Onset of instability", ["way", "largest |F - I|"], rows)
        return stability.describe(found, preset, name)
    with progress("rates", 1.0, "parts") as report:
        errors = initialisation_errors.initialisation_errors(
            cell, progress=lambda done: report(done, "")
        )
    rows = [[method, f"{value:.3f}"] for method, value in errors.order.items()]
    show_table("Order of the error in the rate", ["initialisation", "order"], rows)
    return initialisation_errors.describe(errors, preset, name)


def _bar(
    cell: CellParameters,
    preset: str,
    name: str,
    meshes: tuple[int, ...],
    tissue: bool,
    duration: float,
) -> Study:
    from surrofe2.load_case import LoadCase
    from surrofe2.rve import INITIALISATIONS
    from surrofe2.studies import bar_comparison as bars

    load_case = LoadCase(duration=duration)
    runs = []
    if tissue:
        with progress("full tissue", duration, "µs") as report:
            runs.append(bars.run_tissue(cell, load_case, progress=lambda t, _: report(t, "")))
    else:
        say("the full tissue is left out (--no-tissue): nothing is compared with it")
    for n in meshes:
        for method in INITIALISATIONS:
            with progress(f"{method} {n}x{n}", duration, "µs") as report:
                run = bars.run_bar(
                    cell, method, (n, n), load_case, progress=lambda t, _: report(t, "")
                )
            runs.append(run)
    return bars.describe(
        tuple(runs), load_case, preset, name,
        relative_tolerance=bars.RELATIVE_TOLERANCE, absolute_tolerance=bars.ABSOLUTE_TOLERANCE,
        duration=duration,
    )  # fmt: skip

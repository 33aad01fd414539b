"""`surrofe2 reproduce`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from surrofe2.cli.console import (
    CellName,
    Fresh,
    done,
    integers,
    on_interrupt,
    print_line,
    progress,
    show_table,
)
from surrofe2.report.study import NamedCell
from surrofe2.workflow.reproduce import CURVES, MEMORY, THIN, Bars, reproduce_figure

Figure = Literal[
    "fig5",
    "fig6",
    "fig8",
    "rates",
    "scales",
    "damping",
    "stability",
    "problems",
    "thin",
    "memory",
]


MESHES = {"fig8": "4,8"}
DURATIONS = {MEMORY: 17.0}


def reproduce(
    figure: Annotated[Figure, typer.Argument(help="Which figure.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the figure's files.")],
    cell: CellName = "printed",
    meshes: Annotated[
        str | None,
        typer.Option(
            metavar="N,…",
            help="fig8, scales, damping: elements a side of each mesh; default 4,8 for fig8, else "
            "4,8,16. thin: plant cells a side of bars, an element for each; default none.",
        ),
    ] = None,
    sizes: Annotated[
        str | None,
        typer.Option(
            metavar="N,…",
            help="scales: plant cells a side of each bar, default 8,16,32. problems: across strip "
            "and block, default 4,8,16,24. thin: across the strips, default 2,4,8,16.",
        ),
    ] = None,
    tissue: Annotated[
        bool, typer.Option("--tissue/--no-tissue", help="fig8: the full tissue as well.")
    ] = True,
    duration: Annotated[
        float | None,
        typer.Option(
            metavar="µs",
            help="fig8, scales, damping: length of a run of 16 x 16 cells, default 250. memory: "
            "period of the fastest motion expected, default 17.",
        ),
    ] = None,
    fresh: Fresh = False,
) -> None:
    """A figure of the paper, its data as CSV and its numbers as JSON.

    fig5: stress of one RVE over shear steps. fig6: mean force and error over iterations. fig8: the
    bending bar by FE² with each initialisation against the full tissue. rates: error of each
    initialisation against micro-integration as the rate goes down. scales: slow manifold against
    full tissues of 8 x 8, 16 x 16 and 32 x 32 plant cells. damping: decrements over mesh,
    tolerances, micro step and ways to fit. stability: where the plant cell has a stable
    equilibrium. problems: strip, block between plates and skin against full tissues. thin: strips,
    a cantilever and bars with and without the surface law. memory: whether a cache on (F, Ḟ) is
    sound, by two pasts that end in the same (F, Ḟ). The last seven are not in the paper;
    fig8, scales, damping, problems and thin keep each run's curve in DIR/curves.

    Example: [bold]surrofe2 reproduce fig5 --cell water --out out/paper[/bold]

    Next: look at DIR/fig5-water.png; [bold]surrofe2 reproduce fig8[/bold] compares whole bars.
    """
    of = NamedCell.of(cell)
    usual = MESHES.get(figure, "4,8,16")
    bars = Bars(
        meshes=() if figure == THIN and not meshes else integers("--meshes", meshes or usual),
        sizes=None if sizes is None else integers("--sizes", sizes),
        tissue=tissue,
        duration=DURATIONS.get(figure, 250.0) if duration is None else duration,
    )
    with on_interrupt(f"{out / CURVES} keeps the finished curves of bars"):
        study, paths = reproduce_figure(figure, of, out, bars, fresh=fresh, stage=progress)
    if study is not None:
        show_table(f"{' '.join(study.title.split())}, {of}", study.table)
        for row in study.table.to_records():
            if "verdict" in row:
                print_line(row["verdict"])
    names = ", ".join(path.name for path in paths)
    done(out, names if study is not None else f"{names}, there already")

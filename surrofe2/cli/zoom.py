"""`surrofe2 zoom`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from surrofe2.base.errors import InputError
from surrofe2.cli import console
from surrofe2.workflow.laws import use_threads
from surrofe2.workflow.zoom import write_zoom, zoom_into


def zoom(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run or a rest.")],
    point: Annotated[str, typer.Option(metavar="X,Y", help="Position in the unloaded tissue, µm.")],
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="The folder to write; default: RUN/zoom-X-Y."),
    ] = None,
    threads: console.Threads = None,
) -> None:
    """Look into the plant cells of a run: the RVE at a point over time.

    True RVEs, of cached runs too, take the mean F and Ḟ of the element at the point at the times
    of the run's fields. DIR receives zoom.png, zoom.csv (stretch and tension of walls, turgor,
    area, contact pressure over time) and fields.xdmf for ParaView.

    Example: [bold]surrofe2 zoom out/cached --point 200,12.5[/bold]
    """
    use_threads(threads)
    x, y = _position(point)
    folder = run / f"zoom-{x:g}-{y:g}" if out is None else out
    with console.working("zoom", 1.0, "parts", f"{folder} may lack files") as report:
        report(0.0, "plant cells")
        look = zoom_into(run, (x, y))
        write_zoom(look, folder, report)
    last = {name: values[-1] for name, values in look.seen.extremes().items()}
    console.done(
        folder,
        f"element {look.element} at {len(look.t)} times; at the last wall stretch up "
        f"to {last['largest_wall_stretch']:.4g}, turgor {last['lowest_turgor_uN_per_um']:.3g} to "
        f"{last['highest_turgor_uN_per_um']:.3g} µN/µm",
    )


def _position(text: str) -> tuple[float, float]:
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--point: {text!r}; it must be two numbers X,Y in µm") from None
    return x, y

"""Studies of many bars: each run's curve is kept, so that an interrupted one goes on from there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from surrofe2.cli.console import keeping, progress, say

if TYPE_CHECKING:
    from surrofe2.io.kept_curves import KeptCurves
    from surrofe2.plant_cell.parameters import CellParameters
    from surrofe2.report.study import Study
    from surrofe2.studies.bar_comparison import BarRun
    from surrofe2.studies.bar_pieces import Piece

FOLDER = "curves"


def scales_study(
    cell: CellParameters,
    preset: str,
    name: str,
    out: Path,
    sizes: tuple[int, ...],
    meshes: tuple[int, ...],
    duration: float,
) -> Study:
    """FE² by slow manifold against full tissues of growing size."""
    from surrofe2.studies import scale_separation as scales

    pieces = scales.pieces(cell, preset, sizes, meshes, duration=duration)
    runs = make_all([piece for _, piece in pieces], out)
    of_size: dict[int, list[BarRun]] = {n: [] for n in sizes}
    for (n, _), run in zip(pieces, runs, strict=True):
        of_size[n].append(run)
    rows = scales.deviations(of_size)
    return scales.describe(rows, preset, name, sizes=sizes, meshes=meshes, duration=duration)


def damping_study(
    cell: CellParameters,
    preset: str,
    name: str,
    out: Path,
    meshes: tuple[int, ...],
    duration: float,
) -> Study:
    """Decrement of each initialisation over mesh, tolerances, micro step and ways to fit."""
    from surrofe2.studies import damping

    pieces = damping.pieces(cell, preset, meshes, duration)
    runs = make_all(pieces, out)
    found = damping.dampings(list(zip(pieces, runs, strict=True)))
    return damping.describe(found, preset, name, meshes=meshes, duration=duration)


def make_all(pieces: list[Piece], out: Path) -> list[BarRun]:
    """The runs of all pieces, those that are kept in `out` not computed again."""
    from surrofe2.io.kept_curves import KeptCurves

    kept = KeptCurves(out / FOLDER)
    there = sum(kept.read(piece.name, piece.configuration()) is not None for piece in pieces)
    if there:
        say(f"{kept.folder}: {there} of {len(pieces)} curves are there already")
    with keeping(f"{kept.folder} keeps the finished curves; the same command goes on from there"):
        return [_made(piece, kept, k + 1, len(pieces)) for k, piece in enumerate(pieces)]


def _made(piece: Piece, kept: KeptCurves, number: int, count: int) -> BarRun:
    from surrofe2.studies.bar_pieces import made

    with progress(f"{number} of {count}: {piece.label}", piece.load_case.duration, "µs") as report:
        return made(piece, kept, lambda t, _: report(t, ""))

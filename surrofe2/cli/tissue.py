"""`surrofe2 tissue`."""

from __future__ import annotations

from surrofe2.cli import console
from surrofe2.workflow.laws import open_study, recipe_notes
from surrofe2.workflow.tissue import run_tissue, tissue_notes, tissue_summary


def tissue(
    recipe: console.RecipeFile,
    out: console.RunFolder,
    threads: console.Threads = None,
    fresh: console.Fresh = False,
) -> None:
    """Simulate the whole tissue particle by particle, without homogenisation.

    The bar of [load], or a mesh of one or several cells with the conditions and rigid bodies of
    FE²: it has the plant cells whose middles the mesh holds. Walls at the free boundary are single.
    With a section [image] the walls are the outlines of its cells, from its lower left corner.
    The tissue is relaxed without load, then loaded.
    DIR receives run.json (configuration, costs), curve.csv (t in µs, displacement of watched
    particles in µm), history.csv (forces in µN), energies.csv (pJ) and fields.xdmf for ParaView.

    Example: surrofe2 tissue data/bending-bar.toml --out out/tissue

    Next: surrofe2 compare out/tissue out/rve --out out/comparison
    """
    study = open_study(recipe, threads)
    console.show_notes(recipe_notes(study))
    console.show_notes(tissue_notes(study))
    with console.running("full tissue", study.duration, "µs", out) as report:
        record = run_tissue(study, out, fresh=fresh, report=report)
    console.done(out, tissue_summary(record), timed=False)

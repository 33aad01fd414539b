"""Larger bars over 250 µs: is the first run faster, with data and training counted?

Full FE² of the largest is estimated, for it takes from half an hour to days: its number of RVE
solves times the seconds per solve of the same bar on fewer elements, run in full beside it.
"""

from __future__ import annotations

from benchmarks import commands
from benchmarks.measured import ROOT, Bench

FEWER = {"large-bar.toml": ("[64, 64]", "[16, 16]"), "voronoi-large.toml": ("[16, 16]", "[4, 4]")}


def run(bench: Bench) -> None:
    """Squares, then Voronoi cells; both by the cache and by a table."""
    for name, key in (("large-bar.toml", "printed"), ("voronoi-large.toml", "voronoi")):
        if not bench.quick or key == "printed":
            _first_run(bench, name, key)


def _first_run(bench: Bench, name: str, key: str) -> None:
    out = bench.out / "large" / key
    many, few = FEWER[name]
    if bench.quick:
        many, few = "[64, 64]", "[4, 4]"
    small = commands.shipped(name, out / "few", many, few)
    recipe = commands.shipped(name, out, *((many, "[8, 8]") if bench.quick else ()))
    commands.made(recipe)
    full = commands.run(small, "rve", out / "rve")
    per_solve = full["wall_time"]["total"] / full["counts"]["rve_solves"]
    cached = commands.run(recipe, "cached", out / "cached")
    table = commands.run(recipe, "table", out / "table")
    solves = _solves(name, full, cached)
    estimated, make = per_solve * solves, commands.seconds_to_make(cached)
    alone, by_table = (each["wall_time"]["total"] for each in (cached, table))
    audit, least = cached["cache"]["audit"], {"printed": 20.0, "voronoi": 30.0}[key]
    bench.add_group(f"large.{key}", (
        ("solves", solves, "", "RVE solves of full FE²"),
        ("full_seconds", estimated, "s",
         "full FE², estimated from the same bar on fewer elements"),
        ("make_seconds", make, "s", "data set, training and calibration"),
        ("cached_seconds", alone, "s", "cached FE², the run alone"),
        ("table_seconds", by_table, "s", "FE² by a table that starts empty"),
        ("first_run", estimated / (make + alone), "×",
         "first cached run faster than full FE², data and training counted", {"at_least": least}),
        ("table", estimated / by_table, "×", "FE² by an empty table faster than full FE²",
         {"at_least": 12.0}),
        ("audited", audit["audited"], "", "answers audited"),
        ("above", audit["violations"], "", "of these above the tolerance", {"at_most": 0.0}),
    ))  # fmt: skip


def _solves(name: str, full: dict, cached: dict) -> float:
    """RVE solves of full FE² on the many elements: as counted, or one per stress of the cache."""
    kept = ROOT / "data" / f"{name.removesuffix('.toml')}-true"
    if kept.exists():
        return float(commands.record(kept)["counts"]["rve_solves"])
    counts = cached["counts"]
    return float(counts["stress_points"] + counts["dissipation_points"])

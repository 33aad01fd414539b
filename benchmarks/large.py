"""Larger tissues: is the first run faster, with data and training counted?

`large-bar.toml` has 256 × 256 plant cells. Its cached run and its run by a table are whole. Full
FE² is run over the first `FIRST` µs, beside which the cached run is compared; the whole of it is as
many solves as the cached run has stresses, by the same tolerances, times the seconds of one there.
The full particle model is extrapolated: its particles times its steps, times the seconds for one
particle and step of tissues of 16, 32 and 48 plant cells across. `python -m benchmarks quarter`
runs full FE² over the first quarter of a period.

`voronoi-large.toml` has elements as small as its RVEs. Full FE² of it is estimated from the same
bar on fewer elements, run in full beside it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import commands
from benchmarks.measured import Bench
from surrofe2.recipe.recipe import load_recipe
from surrofe2.store.run_folder import read_run
from surrofe2.workflow.scale import all_particles

FIRST = 160.0
"""µs of the large bar that full FE² computes; some minutes."""
ACROSS = (16, 32, 48)
"""Plant cells across the tissues whose particles are timed."""
_PARTICLE_DURATION = 2.0
"""µs that they are run for."""


def run(bench: Bench) -> None:
    """The large bar by cache, table, RVEs and particles; then Voronoi cells."""
    _large_bar(bench)
    if not bench.quick:
        _voronoi(bench)


def quarter(bench: Bench) -> None:
    """Full FE² of the large bar over a quarter of a period, and the cached run beside it."""
    out = _folder(bench)
    commands.made(_recipe(bench))
    commands.run(_recipe(bench), "cached", out / "cached")
    curve = read_run(out / "cached").curve
    # from rest the bar swings to its first largest displacement in half a period
    half = float(curve.t[np.linalg.norm(curve.displacement, axis=1).argmax()])
    found = _beginning(bench, 0.5 * half)
    bench.add(
        "large.printed.quarter_error",
        found["error"],
        "%",
        "largest difference in displacement, cached against full FE², over a quarter of a period",
        at_most=0.1,
    )


def _folder(bench: Bench) -> Path:
    return bench.out / "large" / "printed"


def _recipe(bench: Bench, *changes: str) -> Path:
    """The large bar; in quick mode of few elements and a short time."""
    path = commands.shipped("large-bar.toml", _folder(bench))
    if bench.quick:
        few = ("[64, 64]", "[8, 8]", "= 4000.0", "= 80.0")
        changes = (*few, *changes)
    return commands.changed(path, *changes)


def _beginning(bench: Bench, duration: float) -> dict[str, float]:
    """Full FE² over the first µs of the large bar: seconds of a solve, and how far the cached run
    is off, in % of the largest displacement."""
    out = _folder(bench) / "beginning"
    text = "= 80.0" if bench.quick else "= 4000.0"
    recipe = commands.changed(_recipe(bench), text, f"= {duration}", name="beginning.toml")
    full = commands.run(recipe, "rve", out / "rve")
    commands.run(recipe, "cached", out / "cached")
    found = commands.compared(out / "rve", out / "cached", out=out / "comparison")["cached"]
    return {
        "per_solve": full["wall_time"]["total"] / full["counts"]["rve_solves"],
        "error": 100.0 * found["difference"]["largest"],
    }


def _large_bar(bench: Bench) -> None:
    out, recipe = _folder(bench), _recipe(bench)
    commands.made(recipe)
    cached = commands.run(recipe, "cached", out / "cached")
    table = commands.run(recipe, "table", out / "table")
    begun = _beginning(bench, bench.pick(FIRST, 20.0))
    counts, audit = cached["counts"], cached["cache"]["audit"]
    solves = float(counts["stress_points"] + counts["dissipation_points"])
    full, make = begun["per_solve"] * solves, commands.seconds_to_make(cached)
    alone, by_table = (each["wall_time"]["total"] for each in (cached, table))
    evaluation = 1e3 * alone / counts["right_hand_sides"]
    per_step = _seconds_of_a_particle_step(bench)
    particles = all_particles(load_recipe(recipe))
    by_particles = per_step * particles.particles * particles.steps
    bench.add_group("large.printed", (
        ("particle_steps", particles.particles * particles.steps, "",
         "particles times steps of the full particle model"),
        ("particles_seconds", by_particles, "s",
         "full particle model, extrapolated from tissues of 16, 32 and 48 plant cells across"),
        ("solves", solves, "", "RVE solves of full FE², one for each stress of the cached run"),
        ("full_seconds", full, "s", "full FE², extrapolated from its first 160 µs"),
        ("make_seconds", make, "s", "data set, training and calibration"),
        ("cached_seconds", alone, "s", "cached FE², the run alone"),
        ("evaluation", evaluation, "ms", "cached run, one evaluation, all included"),
        ("table_seconds", by_table, "s", "FE² by a table that starts empty"),
        ("first_run", full / (make + alone), "×",
         "first cached run faster than full FE², data and training counted", {"at_least": 33.0}),
        ("over_particles", by_particles / (make + alone), "×",
         "first cached run faster than the full particle model, data and training counted"),
        ("table", full / by_table, "×", "FE² by an empty table faster than full FE²",
         {"at_least": 12.0}),
        ("displacement_error", begun["error"], "%",
         "largest difference in displacement, cached against full FE², over the first 160 µs",
         {"at_most": 0.1}),
        ("audited", audit["audited"], "", "answers audited"),
        ("above", audit["violations"], "", "of these above the tolerance", {"at_most": 0.0}),
    ))  # fmt: skip


def _seconds_of_a_particle_step(bench: Bench) -> float:
    """Of the full particle model, the last of growing tissues; each is recorded."""
    seconds = 0.0
    for across in bench.pick(ACROSS, ACROSS[:1]):
        width = 25.0 * across
        recipe = commands.changed(
            commands.shipped("large-bar.toml", _folder(bench)),
            "= 6400.0", f"= {width}", "[6400.0, 3200.0]", f"[{width}, {0.5 * width}]",
            "= 4000.0", f"= {_PARTICLE_DURATION}", "= 8.0", "= 0.5", name=f"tissue-{across}.toml",
        )  # fmt: skip
        out = _folder(bench) / f"tissue-{across}"
        commands.surrofe2("tissue", recipe, "--out", out, "--fresh")
        record: dict[str, Any] = commands.record(out)
        seconds = record["wall_time"]["run"] / record["counts"]["particle_steps"]
        bench.add(
            f"large.printed.particle_step.{across}",
            1e9 * seconds,
            "ns",
            f"a particle and step of {across} × {across} plant cells",
        )
    return seconds


def _voronoi(bench: Bench) -> None:
    out = bench.out / "large" / "voronoi"
    name, many, few = "voronoi-large.toml", "[16, 16]", "[4, 4]"
    small, recipe = commands.shipped(name, out / "few", many, few), commands.shipped(name, out)
    commands.made(recipe)
    full = commands.run(small, "rve", out / "rve")
    per_solve = full["wall_time"]["total"] / full["counts"]["rve_solves"]
    cached = commands.run(recipe, "cached", out / "cached")
    table = commands.run(recipe, "table", out / "table")
    counts, audit = cached["counts"], cached["cache"]["audit"]
    solves = float(counts["stress_points"] + counts["dissipation_points"])
    estimated, make = per_solve * solves, commands.seconds_to_make(cached)
    alone, by_table = (each["wall_time"]["total"] for each in (cached, table))
    bench.add_group("large.voronoi", (
        ("solves", solves, "", "RVE solves of full FE²"),
        ("full_seconds", estimated, "s",
         "full FE², estimated from the same bar on fewer elements"),
        ("make_seconds", make, "s", "data set, training and calibration"),
        ("cached_seconds", alone, "s", "cached FE², the run alone"),
        ("table_seconds", by_table, "s", "FE² by a table that starts empty"),
        ("first_run", estimated / (make + alone), "×",
         "first cached run faster than full FE², data and training counted", {"at_least": 30.0}),
        ("table", estimated / by_table, "×", "FE² by an empty table faster than full FE²",
         {"at_least": 12.0}),
        ("audited", audit["audited"], "", "answers audited"),
        ("above", audit["violations"], "", "of these above the tolerance", {"at_most": 0.0}),
    ))  # fmt: skip

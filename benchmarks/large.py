"""Larger tissues: is the first run faster, with data and training counted?

`large-bar.toml` has 256 × 256 plant cells, `voronoi-large.toml` 192 × 192 irregular ones. The
cached run of each and its run by a table are whole. Full FE² is run over the first µs, beside which
the cached run is compared; the whole of it is as many solves as the cached run has stresses, by the
same tolerances, times the seconds of one there. `python -m benchmarks quarter` runs full FE² of the
squares over a quarter of a period.

The full particle model of the squares is extrapolated: its particles times its steps, times the
seconds for one particle and step of tissues of 16, 32 and 48 plant cells across.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import commands
from benchmarks.measured import Bench
from surrofe2.recipe.recipe import load_recipe
from surrofe2.store.run_folder import read_run
from surrofe2.workflow.scale import all_particles

ACROSS = (16, 32, 48)
"""Plant cells across the tissues whose particles are timed."""
_PARTICLE_DURATION = 2.0
"""µs that they are run for."""


@dataclass(frozen=True, slots=True)
class _Bar:
    """A large bar.

    Attributes:
        name: name of its figures.
        recipe: its recipe in data/.
        duration: text of the duration in the recipe, µs.
        first: µs that full FE² computes, some minutes; the second number is for quick mode.
        aims: speed-up over full FE² that the cached run and the table are to reach, all counted.
    """

    name: str
    recipe: str
    duration: str
    first: tuple[float, float]
    aims: tuple[float, float]


_SQUARES = _Bar("printed", "large-bar.toml", "= 4000.0", (160.0, 20.0), (33.0, 12.0))
_VORONOI = _Bar("voronoi", "voronoi-large.toml", "= 3000.0", (20.0, 4.0), (50.0, 12.0))
_SHORT = "= 80.0"
"""Duration of either in quick mode, µs."""


def run(bench: Bench) -> None:
    """The large bar by cache, table, RVEs and particles; then Voronoi cells."""
    _against_particles(bench, _bar(bench, _SQUARES))
    if not bench.quick:
        _bar(bench, _VORONOI)


def quarter(bench: Bench) -> None:
    """Full FE² of the large bar over a quarter of a period, and the cached run beside it."""
    out = _folder(bench, _SQUARES)
    recipe = _recipe(bench, _SQUARES)
    commands.made(recipe)
    commands.run(recipe, "cached", out / "cached")
    curve = read_run(out / "cached").curve
    # from rest the bar swings to its first largest displacement in half a period
    half = float(curve.t[np.linalg.norm(curve.displacement, axis=1).argmax()])
    beginning = _beginning(bench, _SQUARES, 0.5 * half)
    bench.add(
        "large.printed.quarter_error",
        beginning["error"],
        "%",
        "largest difference in displacement, cached against full FE², over a quarter of a period",
        at_most=0.1,
    )


def _folder(bench: Bench, bar: _Bar) -> Path:
    return bench.out / "large" / bar.name


def _recipe(bench: Bench, bar: _Bar) -> Path:
    """Copy the recipe of a bar; in quick mode with few elements and a short time."""
    path = commands.shipped(bar.recipe, _folder(bench, bar))
    few = ("[64, 64]", "[8, 8]", bar.duration, _SHORT) if bench.quick else ()
    return commands.changed(path, *few)


def _beginning(bench: Bench, bar: _Bar, duration: float) -> dict[str, float]:
    """Run full FE² over the first µs of a bar, and the cached run beside it.

    Return the seconds of a solve as "per_solve", and the difference of the cached run as "error",
    in % of the largest displacement.
    """
    out = _folder(bench, bar) / "beginning"
    text = _SHORT if bench.quick else bar.duration
    recipe = commands.changed(_recipe(bench, bar), text, f"= {duration}", name="beginning.toml")
    full = commands.run(recipe, "rve", out / "rve")
    commands.run(recipe, "cached", out / "cached")
    cached = commands.compared(out / "rve", out / "cached", out=out / "comparison")["cached"]
    return {
        "per_solve": full["wall_time"]["total"] / full["counts"]["rve_solves"],
        "error": 100.0 * cached["difference"]["largest"],
    }


def _bar(bench: Bench, bar: _Bar) -> float:
    """Run a bar by cache, by table and in the beginning by full FE².

    Return the seconds of the first cached run, data and training counted.
    """
    out = _folder(bench, bar)
    recipe = _recipe(bench, bar)
    commands.made(recipe)
    cached = commands.run(recipe, "cached", out / "cached")
    table = commands.run(recipe, "table", out / "table")
    first = bench.pick(*bar.first)
    begun = _beginning(bench, bar, first)
    counts = cached["counts"]
    audit = cached["cache"]["audit"]
    solves = float(counts["stress_points"] + counts["dissipation_points"])
    full = begun["per_solve"] * solves
    make = commands.seconds_to_make(cached)
    alone = cached["wall_time"]["total"]
    by_table = table["wall_time"]["total"]
    by_cache, by_empty_table = bar.aims
    bench.add_group(f"large.{bar.name}", (
        ("solves", solves, "", "RVE solves of full FE², one for each stress of the cached run"),
        ("full_seconds", full, "s", f"full FE², extrapolated from its first {first:g} µs"),
        ("make_seconds", make, "s", "data set, training and calibration"),
        ("cached_seconds", alone, "s", "cached FE², the run alone"),
        ("evaluation", 1e3 * alone / counts["right_hand_sides"], "ms",
         "cached run, one evaluation, all included"),
        ("table_seconds", by_table, "s", "FE² by a table that starts empty"),
        ("first_run", full / (make + alone), "×",
         "first cached run faster than full FE², data and training counted",
         {"at_least": by_cache}),
        ("table", full / by_table, "×", "FE² by an empty table faster than full FE²",
         {"at_least": by_empty_table}),
        ("displacement_error", begun["error"], "%",
         "largest difference in displacement, cached against full FE², over the first "
         f"{first:g} µs",
         {"at_most": 0.1}),
        ("audited", audit["audited"], "", "answers audited"),
        ("above", audit["violations"], "", "of these above the tolerance", {"at_most": 0.0}),
    ))  # fmt: skip
    return float(make + alone)


def _against_particles(bench: Bench, first_run: float) -> None:
    """Add figures of the full particle model of the squares; `first_run` are seconds beside it."""
    per_step = _seconds_of_a_particle_step(bench)
    particles = all_particles(load_recipe(_recipe(bench, _SQUARES)))
    by_particles = per_step * particles.particles * particles.steps
    bench.add_group("large.printed", (
        ("particle_steps", particles.particles * particles.steps, "",
         "particles times steps of the full particle model"),
        ("particles_seconds", by_particles, "s",
         "full particle model, extrapolated from tissues of 16, 32 and 48 plant cells across"),
        ("over_particles", by_particles / first_run, "×",
         "first cached run faster than the full particle model, data and training counted"),
    ))  # fmt: skip


def _seconds_of_a_particle_step(bench: Bench) -> float:
    """Time growing tissues of particles, record each, and return the seconds of the last."""
    seconds = 0.0
    for across in bench.pick(ACROSS, ACROSS[:1]):
        width = 25.0 * across
        recipe = commands.changed(
            commands.shipped(_SQUARES.recipe, _folder(bench, _SQUARES)),
            "= 6400.0", f"= {width}", "[6400.0, 3200.0]", f"[{width}, {0.5 * width}]",
            "= 4000.0", f"= {_PARTICLE_DURATION}", "= 8.0", "= 0.5", name=f"tissue-{across}.toml",
        )  # fmt: skip
        out = _folder(bench, _SQUARES) / f"tissue-{across}"
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

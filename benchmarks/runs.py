"""The shipped bars by whole commands, in turns: full FE², then cached FE² with its audits."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks import commands
from benchmarks.measured import Bench

RECIPES = {
    "printed": "bending-bar.toml",
    "water": "bending-bar-water.toml",
    "voronoi": "voronoi-bar.toml",
}


def run(bench: Bench) -> None:
    """All recipes; `printed` alone in quick mode."""
    for name in bench.pick(tuple(RECIPES), ("printed",)):
        bar(bench, name)


def bar(bench: Bench, name: str) -> None:
    """One recipe: how it was made, what a run costs by each law, how far the curves are apart."""
    out = bench.out / "runs" / name
    recipe = commands.shipped(RECIPES[name], out)
    commands.made(recipe)
    pairs = []
    for turn in range(bench.pick(2 if name == "voronoi" else 6, 2)):
        both = [commands.run(recipe, law, out / law) for law in ("rve", "cached")]
        if turn:  # the first pair fills caches of kernels and files
            pairs.append(both)
    full, cached = ([pair[k] for pair in pairs] for k in (0, 1))
    seconds = np.array([[one["wall_time"]["total"] for one in pair] for pair in pairs])
    process = np.array([[one["process"] for one in pair] for pair in pairs])
    compared = commands.compared(out / "rve", out / "cached", out=out / "comparison")["cached"]
    audit = compared["cache"]["audit"]
    quotient = seconds[:, 0] / seconds[:, 1]
    stress = _relative_rms(cached[-1]["surrogate"]["errors"])
    bench.add_group(name, (
        ("surrogate_rms", 100.0 * stress, "%",
         "error of the surrogate's stress on held-out samples, RMS, of the spread of stress",
         {"at_most": 0.1}),
        ("make_seconds", commands.seconds_to_make(cached[-1]), "s",
         "data set, training and calibration"),
        ("full_seconds", np.median(seconds[:, 0]), "s", "full FE², the run alone"),
        ("cached_seconds", np.median(seconds[:, 1]), "s", "cached FE², audits on, the run alone"),
        ("speed_up", np.median(quotient), "×", "cached FE² faster than full FE², the run alone",
         {"spread": float(np.subtract(*np.percentile(quotient, (75, 25)))), "at_least": 4.0}),
        ("first_run", np.median(seconds[:, 0]) / (commands.seconds_to_make(cached[-1])
                                                  + np.median(seconds[:, 1])), "×",
         "first cached run faster than full FE², data and training counted"),
        ("command_speed_up", np.median(process[:, 0] / process[:, 1]), "×",
         "`surrofe2 run --law cached` faster than `--law rve`, whole command",
         {"at_least": 1.8 if name == "printed" else None}),
        ("start_seconds", np.median(process[:, 1] - seconds[:, 1]), "s",
         "what `surrofe2 run --law cached` takes besides the run"),
        ("displacement_error", 100.0 * compared["difference"]["largest"], "%",
         "largest difference in displacement, cached against full FE²", {"at_most": 0.1}),
        ("solves", full[-1]["counts"]["rve_solves"], "", "RVE solves of full FE²"),
        ("cached_solves", cached[-1]["counts"]["rve_solves"], "",
         "RVE solves of cached FE², audits included"),
        ("audited", audit["audited"], "", "answers that audits checked"),
        ("above", audit["violations"], "", "of these above the tolerance", {"at_most": 0.0}),
    ))  # fmt: skip


def _relative_rms(errors: dict[str, dict[str, float]]) -> float:
    """RMS error of a component of stress over the spread of stress, the worst of the components."""
    spread = max(errors["spread"][each] for each in ("sum", "difference", "shear"))
    return max(
        errors["rms"][each] * errors["spread"][each] / spread
        for each in ("sum", "difference", "shear")
    )


def folder(bench: Bench, name: str) -> Path:
    """Where the runs of a recipe lie."""
    return bench.out / "runs" / name

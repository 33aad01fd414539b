"""The examples' recipes by full and by cached FE²: difference and speed-up."""

from __future__ import annotations

import shutil
from typing import Any

from benchmarks import commands
from benchmarks.measured import ROOT, Bench

NAMES = (
    "block-between-plates",
    "drop-on-plate",
    "tensile-strip",
    "cyclic-shear",
    "notched-leaf",
    "hexagons-in-tension",
    "voronoi-in-tension",
    "skin-over-parenchyma",
)
FOLDER = ROOT / "examples"


def run(bench: Bench) -> None:
    """`surrofe2 study` of every example from scratch, kernels compiled; one turn of each."""
    out = bench.out / "examples"
    (out / "examples").mkdir(parents=True, exist_ok=True)
    for path in (*FOLDER.glob("*.toml"), *FOLDER.glob("*.msh")):
        shutil.copy(path, out / "examples" / path.name)
    for name in bench.pick(NAMES, NAMES[:1]):
        _example(bench, name, commands.studied(out / "examples" / f"{name}.toml", out / name))


def _example(bench: Bench, name: str, cached: dict[str, Any]) -> None:
    """Add the figures of an example from its cached run."""
    balance = cached["balance"]
    audit = cached["cache"]["audit"]
    counts = cached["counts"]
    stresses = counts["stress_points"] + counts.get("dissipation_points", 0)
    forces = [100.0 * force["largest"] for force in cached["forces"].values() if force["scale"]]
    bench.add_group(f"examples.{name.replace('-', '_')}", (
        ("displacement", 100.0 * cached["difference"]["largest"], "%",
         "largest difference in displacement, cached against full FE²", {"at_most": 0.1}),
        ("force", max(forces, default=0.0), "%",
         "largest difference of a force, by the largest, cached against full FE²"),
        ("fallbacks", 100.0 * counts.get("fallbacks", 0) / stresses, "%",
         "stresses that RVEs computed in the cached run"),
        ("speed_up", balance["true"] / balance["run"], "×",
         "cached FE² faster than full FE², both runs alone"),
        ("first_run", balance["true"] / (balance["preparation"] + balance["run"]), "×",
         "first cached run faster than full FE², data and training counted"),
        ("above", audit["violations"], "", "audited answers above the tolerance",
         {"at_most": 0.0}),
    ))  # fmt: skip

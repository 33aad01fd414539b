"""The study of `make demo`: is the first cached run faster, with everything counted?"""

from __future__ import annotations

from benchmarks import commands
from benchmarks.measured import Bench


def run(bench: Bench) -> None:
    """`surrofe2 study data/demo.toml` from scratch, kernels compiled; one turn."""
    recipe = commands.shipped("demo.toml", bench.out / "demo")
    if bench.quick:
        recipe = commands.changed(recipe, "= 750.0", "= 30.0")
    cached = commands.studied(recipe, bench.out / "demo" / "study")
    balance = cached["balance"]
    audit = cached["cache"]["audit"]
    bench.add_group("demo", (
        ("command_seconds", cached["process"], "s",
         "`surrofe2 study data/demo.toml`, the whole command"),
        ("full_seconds", balance["true"], "s", "full FE², the run alone"),
        ("cached_seconds", balance["run"], "s", "cached FE², audits on, the run alone"),
        ("make_seconds", balance["preparation"], "s", "data set, training and calibration"),
        ("first_run", balance["true"] / (balance["preparation"] + balance["run"]), "×",
         "first cached run faster than full FE², data and training counted", {"at_least": 2.0}),
        ("displacement_error", 100.0 * cached["difference"]["largest"], "%",
         "largest difference in displacement, cached against full FE²", {"at_most": 0.1}),
        ("audited", audit["audited"], "", "answers audited"),
        ("above", audit["violations"], "", "of these above the tolerance", {"at_most": 0.0}),
    ))  # fmt: skip

"""A slow test of a large tissue: apple pressed by 10 % at rest, by RVEs and by a table.

The block of `apple-press.toml` with 64 × 64 elements, each of nine irregular plant cells. The table
starts empty, so that neither data nor training come before it.
"""

from __future__ import annotations

from typing import Any

from benchmarks import commands
from benchmarks.measured import Bench

_ELEMENTS = 64
_ELEMENT = 450.0
"""Width of an element, µm: that of its RVE."""
_RANGE = """[range]
stretch = [0.79, 1.09]
shear = 0.11
rate = 1e-6

[rest]"""
"""What `surrofe2 check` finds on the path, in the recipe's words."""


def run(bench: Bench) -> None:
    """Both laws, whole commands, after those of a small block, which fill caches."""
    out = bench.out / "press"
    _both(bench, 6)
    full, table = _both(bench, bench.pick(_ELEMENTS, 6))
    compared = commands.compared(out / "rve", out / "table", out=out / "comparison")["table"]
    audit = table["cache"]["audit"]
    by_rves = full["wall_time"]["total"]
    by_table = table["wall_time"]["total"]
    bench.add_group("press", (
        ("full_seconds", by_rves, "s", "press at rest by RVEs, the load steps alone"),
        ("table_seconds", by_table, "s", "by a table that starts empty, the load steps alone"),
        ("speed_up", by_rves / by_table, "×", "table faster than RVEs, the load steps alone",
         {"at_least": None if bench.quick else 10.0}),
        ("command_speed_up", full["process"] / table["process"], "×",
         "`surrofe2 run --law table` faster than `--law rve`, whole commands: start and closing "
         "estimate counted"),
        ("solves", full["counts"]["rve_solves"], "", "RVE solves of full FE²"),
        ("table_solves", table["counts"]["rve_solves"], "",
         "RVE solves behind the table, audits included"),
        ("displacement_error", 100.0 * compared["difference"]["largest"], "%",
         "largest difference in displacement, table against RVEs", {"at_most": 0.1}),
        ("audited", audit["audited"], "", "answers audited"),
        ("above", audit["violations"], "", "of these above the tolerance", {"at_most": 0.0}),
    ))  # fmt: skip


def _both(bench: Bench, across: int) -> list[dict[str, Any]]:
    """Run a block of so many elements across by RVEs, then by a table, and return both records."""
    out = bench.out / "press"
    width = _ELEMENT * across
    recipe = commands.changed(
        commands.shipped("apple-press.toml", out),
        "= 3600.0", f"= {width}", "[6, 6]", f"[{across}, {across}]",
        "-540.0", f"{-0.1 * width}", "[3600.0, 1800.0]", f"[{width}, {0.5 * width}]",
        "[rest] ", f"{_RANGE} ",
    )  # fmt: skip
    return [commands.run(recipe, law, out / law) for law in ("rve", "table")]

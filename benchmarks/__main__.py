"""`python -m benchmarks`: run the benchmarks and write JSON, a table and the cost plot."""

from __future__ import annotations

import argparse
import os
import shutil
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from time import perf_counter

from benchmarks.report import Outcome, figure, make_report, write_report
from benchmarks.setting import ROOT, Setting

NAMES = (
    "force_evaluation",
    "rve_solve",
    "initialisations",
    "paper_scheme",
    "bar",
    "tissue",
    "trust",
    "macro_overhead",
    "inference",
    "data_set",
    "start_up",
    "commands",
    "linear_cost",
    "ranks",
)
BUSY = 0.5
"""Load average above which times are not to be trusted."""


def main(arguments: Sequence[str] | None = None) -> int:
    """0, or 1 where a benchmark failed; a missed limit is no failure, it shows in the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="less of everything; about a minute")
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=NAMES, default=NAMES)
    parser.add_argument("--out", type=Path, metavar="DIR", default=Path("out/bench"))
    given = parser.parse_args(arguments)
    setting = Setting(given.quick, given.out)
    setting.out.mkdir(parents=True, exist_ok=True)
    load = os.getloadavg()[0]
    if load > BUSY:
        print(f"the machine is busy (load average {load:.1f}): times will be too long")
    chosen = [name for name in NAMES if name in given.only]
    outcomes = [run_benchmark(name, setting) for name in chosen]
    write_report(setting.out, make_report(outcomes, quick=setting.quick, load=load), outcomes)
    print(f"{setting.out / 'benchmarks.md'}, {setting.out / 'benchmarks.json'}")
    failed = [outcome.name for outcome in outcomes if outcome.failure is not None]
    if set(NAMES) <= set(given.only) and not setting.quick and not failed:
        publish(setting.out, ROOT / "docs")
    return 1 if failed else 0


def run_benchmark(name: str, setting: Setting) -> Outcome:
    """One benchmark; what stops it is its outcome, and the others go on."""
    module = import_module(f"benchmarks.{name}")
    print(f"{name}: {module.TITLE}", flush=True)
    begin = perf_counter()
    try:
        rows = module.run(setting)
    except Exception as error:
        print(f"  failed: {error}", file=sys.stderr)
        failure = f"{type(error).__name__}: {error}"
        return Outcome(name, module.TITLE, failure=failure, seconds=perf_counter() - begin)
    for row in rows:
        met = {None: "", True: "  kept", False: "  MISSED"}[row.met]
        value = row.note if row.value is None else figure(row.value)
        print(f"  {value:>10} {row.unit:8} {row.name}{met}", flush=True)
    return Outcome(name, module.TITLE, rows, seconds=perf_counter() - begin)


def publish(out: Path, docs: Path) -> None:
    """Copy the table and the plot of a complete full run to the documentation."""
    shutil.copyfile(out / "benchmarks.md", docs / "benchmarks.md")
    shutil.copyfile(out / "cost.png", docs / "cost.png")


if __name__ == "__main__":
    raise SystemExit(main())

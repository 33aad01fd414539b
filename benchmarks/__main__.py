"""`python -m benchmarks [TOPIC …]`: measure; figures go into docs/measured.json and the pages."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from time import perf_counter

from benchmarks.measured import MEASURED, Bench, merge
from benchmarks.pages import write_figures
from surrofe2.base.environment import take_process

TOPICS = ("demo", "runs", "large", "solve", "tissue", "start", "trust")
ON_REQUEST = ("examples", "ranks", "suites", "quarter", "grow", "press")
BUSY = 0.5
"""Load average above which times are not to be trusted."""


def main(arguments: Sequence[str] | None = None) -> int:
    """0; 1 where a topic failed or a limit was missed. Quick runs write nothing."""
    take_process()
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument(
        "topics", nargs="*", metavar="TOPIC", choices=(*TOPICS, *ON_REQUEST, "tables"),
        help=f"of {', '.join((*TOPICS, *ON_REQUEST))}; default: all but the last "
        "six; tables: measure nothing, write the stored figures into the pages",
    )  # fmt: skip
    parser.add_argument("--quick", action="store_true", help="less of everything, nothing stored")
    parser.add_argument("--out", type=Path, metavar="DIR", default=Path("out/bench").absolute())
    options = parser.parse_args(arguments)
    if options.topics == ["tables"]:
        write_figures()
        return 0
    load = os.getloadavg()[0]
    if load > BUSY:
        print(f"the machine is busy (load average {load:.1f}): times will be too long")
    bench = Bench(options.quick, options.out.absolute())
    failed = False
    for topic in options.topics or TOPICS:
        bench.command = f"python -m benchmarks {topic}"
        print(f"{topic}", flush=True)
        begin = perf_counter()
        try:
            import_module(f"benchmarks.{topic}").run(bench)
        except Exception as error:  # the other topics are measured all the same
            print(f"  failed: {error}", file=sys.stderr, flush=True)
            failed = True
        print(f"  {perf_counter() - begin:.0f} s", flush=True)
        if not bench.quick:
            merge(MEASURED, bench.figures)
            write_figures()
    missed = [name for name, figure in bench.figures.items() if figure.holds is False]
    if missed:
        print(f"limits missed: {', '.join(missed)}")
    return 1 if failed or missed else 0


if __name__ == "__main__":
    raise SystemExit(main())

"""A short run in a process of its own: `python -m benchmarks.probe`; prints JSON.

For what a process that has done other things before cannot tell: the first compilation and the
peak of memory.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from time import perf_counter

BEGIN = perf_counter()


def main() -> None:
    """Run the bar by one law, as `surrofe2 run` does, files aside."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--recipe", type=Path, required=True)
    parser.add_argument("--surrogate", type=Path)
    parser.add_argument("--law", default="rve")
    parser.add_argument("--elements", type=int, default=4)
    parser.add_argument("--duration", type=float, default=0.5)
    given = parser.parse_args()

    from surrofe2.macro import MacroSettings, simulate
    from surrofe2.recipe.recipe import load_recipe
    from surrofe2.workflow.laws import choose_law

    recipe = load_recipe(given.recipe)
    chosen = choose_law(recipe, given.law, given.surrogate)
    mesh = replace(recipe.stated.mesh, elements=(given.elements, given.elements))
    problem = replace(recipe, stated=replace(recipe.stated, mesh=mesh)).problem()
    done = simulate(replace(problem, duration=given.duration), chosen.law, MacroSettings())
    print(
        json.dumps(
            {
                "seconds": perf_counter() - BEGIN,
                "right_hand_sides": done.counts["right_hand_sides"],
                "peak_gigabytes": peak_memory() / 1e9,
            }
        )
    )


def peak_memory() -> float:
    """Largest resident memory of this process so far, bytes.

    Not from `resource`, whose figure on Linux starts at that of the process that started this.
    """
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmHWM:"):
            return 1024.0 * float(line.split()[1])
    raise RuntimeError("no peak memory on this system; Linux is needed")


if __name__ == "__main__":
    main()

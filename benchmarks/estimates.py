"""`python -m benchmarks.estimates RECIPE …`: estimates of `surrofe2 check` beside measured figures.

In a copy of each recipe, without data set and surrogate: `check`, then each piece as a process of
its own, in wall seconds without compilation and with its peak of memory. A run that would take
longer than `--longest` covers a part of the duration; its time and calls are scaled. Nothing but
the standard library is loaded here: on Linux a process inherits the peak of the one that starts it.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

LAWS = ("rve", "table", "cached")
DURATION = re.compile(r"^(duration\s*=\s*)([\d.e+]+)", re.MULTILINE)
HEAD = ("recipe", "what", "unit", "estimate", "measured", "estimate/measured")


class Figure(NamedTuple):
    """One line of the table; None: it is not estimated, or could not be measured."""

    recipe: str
    what: str
    unit: str
    estimate: float | None
    measured: float | None

    @property
    def ratio(self) -> float | None:
        """Estimate over measured."""
        return self.estimate / self.measured if self.estimate and self.measured else None

    def __str__(self) -> str:
        numbers = (self.estimate, self.measured, self.ratio)
        shown = ("–" if each is None else f"{each:.3g}" for each in numbers)
        return "| " + " | ".join((*self[:3], *shown)) + " |"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table and write estimates.json."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.estimates", description=__doc__)
    parser.add_argument("recipes", type=Path, nargs="+", metavar="RECIPE")
    parser.add_argument("--longest", type=float, default=60.0, metavar="S", help="of a run")
    parser.add_argument("--laws", nargs="+", choices=LAWS, default=LAWS)
    parser.add_argument("--out", type=Path, metavar="DIR", default=Path("out/estimates"))
    given = parser.parse_args(arguments)
    print(f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}")
    figures = []
    for recipe in given.recipes:
        for figure in figures_of(recipe, given.out / recipe.stem, given.laws, given.longest):
            print(figure, flush=True)
            figures.append({**figure._asdict(), "ratio": figure.ratio})
    text = json.dumps({"load": os.getloadavg()[0], "figures": figures}, indent=2)
    (given.out / "estimates.json").write_text(text + "\n", encoding="utf-8")


def figures_of(recipe: Path, folder: Path, laws: Sequence[str], longest: float) -> Iterator[Figure]:
    """What is measured of a recipe, one after the other."""
    shutil.rmtree(folder, ignore_errors=True)
    # what it names lies beside it, or in a folder beside its own
    shutil.copytree(recipe.parent, folder / "data", ignore=shutil.ignore_patterns("*.h5", "*.md"))
    own = folder / "data" / recipe.name
    estimate, _ = called("check", own)
    learns = "cached" in laws and estimate["cached"] is not None
    if learns:
        peak = max(called(command, own)[1] for command in ("generate", "train"))
        making = estimate["making"] / 1e9
        yield Figure(recipe.stem, "data set, training, memory", "GB", making, peak / 1e9)
    text = own.read_text(encoding="utf-8")
    for law in laws:
        if estimate[law] is None:
            continue
        part = min(1.0, longest / estimate[law])
        short = own.with_name(f"{law}-{own.name}")
        short.write_text(text if part == 1.0 else shortened(text, part), encoding="utf-8")
        out = folder / law
        _, peak = called("run", short, "--law", law, "--out", out)
        record = json.loads((out / "run.json").read_text(encoding="utf-8"))
        counts, wall = record["counts"], record["wall_time"]["total"]
        if law == "rve":
            asked = counts["stress_points"] + counts.get("dissipation_points", 0)
            calls = asked / estimate["points"] / part
            yield Figure(recipe.stem, "calls of a run", "", estimate["calls"], calls)
        if law == "cached":
            yield from _made(recipe.stem, estimate, record["surrogate"]["cost"])
        yield Figure(recipe.stem, f"run by {law}", "s", estimate[law], wall / part)
        bytes_ = estimate["memory"][law]
        yield Figure(recipe.stem, f"run by {law}, memory", "GB", bytes_ / 1e9, peak / 1e9)


def shortened(recipe: str, part: float) -> str:
    """The text of a recipe over this part of its duration."""
    return DURATION.sub(lambda found: f"{found[1]}{float(found[2]) * part!r}", recipe, count=1)


def _made(stem: str, estimate: dict[str, Any], cost: dict[str, Any]) -> Iterator[Figure]:
    """Data set and training, of all cells."""
    seconds = {"data": 0.0, "training": 0.0}
    for name, each in cost.items():
        seconds["data" if name.startswith("data") else "training"] += each["wall"]
    yield Figure(stem, "data set", "s", estimate["data"], seconds["data"])
    yield Figure(stem, "training, calibration", "s", estimate["training"], seconds["training"])


def called(command: str, *arguments: str | Path) -> tuple[dict[str, Any], float]:
    """What a command gives by --json, and its peak of memory in bytes."""
    words = [sys.executable, "-m", "surrofe2", command, *map(str, arguments), "--json"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        said, error = process.stdout.read(), process.stderr.read()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"surrofe2 {command}: {said.decode()} {error.decode()}")
    return json.loads(said)["result"], 1024.0 * usage.ru_maxrss


if __name__ == "__main__":
    main()

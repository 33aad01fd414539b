"""surrofe2's commands as a user starts them, each a process of its own, and what they leave."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from time import perf_counter
from typing import Any

from benchmarks.measured import ROOT
from surrofe2.recipe.recipe import Recipe, load_recipe


def surrofe2(*arguments: str | Path, ranks: int = 1, **environment: str) -> float:
    """Run a command, and return the seconds of the whole process; a RuntimeError where it fails."""
    command = [sys.executable, "-m", "surrofe2", *map(str, arguments)]
    if ranks > 1:
        command = [str(Path(sys.executable).with_name("mpiexec")), "-n", str(ranks), *command]
    kept = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    begin = perf_counter()
    done = subprocess.run(
        command, cwd=ROOT, env=kept | environment, capture_output=True, text=True, check=False
    )
    seconds = perf_counter() - begin
    if done.returncode:
        words = [line for line in done.stderr.splitlines() if line.strip()] or ["no message"]
        raise RuntimeError(f"surrofe2 {' '.join(map(str, arguments))}: {words[-1]}")
    return seconds


_WATCH = """import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True, capture_output=True)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


def peak_memory(*arguments: str | Path) -> float:
    """Run a command, and return its largest resident memory, bytes."""
    command = [sys.executable, "-c", _WATCH, sys.executable, "-m", "surrofe2", *map(str, arguments)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return 1024.0 * float(done.stdout)  # KiB on Linux


def run(recipe: Path, law: str, out: Path, *options: str, **more: Any) -> dict[str, Any]:
    """Run a recipe from scratch, and return run.json, with the command's seconds as "process"."""
    seconds = surrofe2("run", recipe, "--law", law, "--out", out, "--fresh", *options, **more)
    return record(out) | {"process": seconds}


def record(folder: Path) -> dict[str, Any]:
    """Read run.json of a run folder."""
    entries: dict[str, Any] = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    return entries


def compared(reference: Path, *folders: Path, out: Path) -> dict[str, dict[str, Any]]:
    """Compare runs with a reference, and return the entries of each by the name of its folder."""
    surrofe2("compare", reference, *folders, "--out", out, "--fresh")
    return {run["name"]: run for run in _compared_runs(out)}


def studied(recipe: Path, out: Path) -> dict[str, Any]:
    """Study a recipe, and return the cached run as compared, with the seconds as "process"."""
    seconds = surrofe2("study", recipe, "--out", out, "--fresh")
    (cached,) = [run for run in _compared_runs(out / "comparison") if run["law"] == "cached"]
    return cached | {"process": seconds}


def _compared_runs(folder: Path) -> list[dict[str, Any]]:
    """Read the entries of the runs in a comparison."""
    text = (folder / "comparison.json").read_text(encoding="utf-8")
    runs: list[dict[str, Any]] = json.loads(text)["runs"]
    return runs


def shipped(name: str, out: Path, old: str = "", new: str = "") -> Path:
    """Copy a recipe of data/ into `out`, where its files will lie, too; `old` becomes `new`."""
    text = (ROOT / "data" / name).read_text(encoding="utf-8")
    if old not in text:
        raise ValueError(f"data/{name} has no line {old!r}")
    out.mkdir(parents=True, exist_ok=True)
    path = out / name
    path.write_text(text.replace("../training/", "trained-").replace(old, new), encoding="utf-8")
    return path


def changed(recipe: Path, *pairs: str, name: str = "") -> Path:
    """Replace the old texts of pairs (old, new, …) in a recipe, or in a copy of another name."""
    text = recipe.read_text(encoding="utf-8")
    for old, new in zip(pairs[::2], pairs[1::2], strict=True):
        if old not in text:
            raise ValueError(f"{recipe.name} has no {old!r}")
        text = text.replace(old, new)
    path = recipe.with_name(name or recipe.name)
    path.write_text(text, encoding="utf-8")
    return path


def made(recipe: Path) -> Recipe:
    """Make data set and surrogate of a recipe unless they are there, and return the recipe."""
    surrofe2("generate", recipe)
    surrofe2("train", recipe)
    return load_recipe(recipe)


def seconds_to_make(run: dict[str, Any]) -> float:
    """Return the seconds of data set, training and calibration behind a cached run."""
    return float(sum(run["surrogate"]["seconds"].values()))

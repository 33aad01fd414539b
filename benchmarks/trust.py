"""Does the cache keep its tolerance? Runs of other loads, every accepted answer audited by an RVE.

The surrogates are those of the shipped recipes. A table learns in a first run and is judged in a
second.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure as Picture
from PIL import Image

from benchmarks import commands, runs
from benchmarks.measured import ROOT, Bench, Figure, read
from surrofe2 import (
    CachedLaw,
    CacheSettings,
    LoadCase,
    MacroSettings,
    RveLaw,
    SurrogateLaw,
    difference,
    read_surrogate,
    simulate,
)
from surrofe2.cache import StressTable
from surrofe2.problem import Problem
from surrofe2.run.charts import BLUE, VERMILION

BORNE = {"printed": 60.0, "water": 20.0}
"""µs for which the bar bears three times its load; then full FE² loses its RVEs."""
PICTURE = ROOT / "docs" / "trust.png"


@dataclass(frozen=True, slots=True)
class Case:
    """A load that nothing was trained for, but for the first."""

    name: str
    words: str
    problem: Problem
    macro: MacroSettings = MacroSettings()  # noqa: RUF009 - frozen


def cases(preset: str, duration: float = 250.0) -> tuple[Case, ...]:
    """The bars that the surrogate of the shipped recipe is tried on."""
    push = tuple((t * duration, a) for t, a in ((0.0, 0.0), (0.1, 1.0), (0.4, 1.0), (0.6, -1.0)))

    def bar(**changes: object) -> Problem:
        return LoadCase(**{"duration": duration} | changes)  # type: ignore[arg-type]

    return (
        Case("default", "default bar", bar()),
        Case("twice", "twice the load", bar(body_force=(0.0, -0.4))),
        Case("thrice", "three times the load, as long as the cells bear it",
             bar(body_force=(0.0, -0.6), duration=min(duration, BORNE[preset]))),
        Case("mesh", "500 × 300 µm, 10 × 6 elements",
             bar(width=500.0, height=300.0, watched=(500.0, 150.0), elements=(10, 6))),
        Case("pulled", "pulled along its length", bar(body_force=(0.2, 0.0))),
        Case("thousandth", "pulled by a thousandth of that", bar(body_force=(2e-4, 0.0)),
             MacroSettings(absolute_tolerance=1e-8)),
        Case("pushed", "pushed, 1.5 times the load", bar(body_force=(-0.3, 0.0))),
        Case("reversed", "sideways push that reverses",
             bar(body_force=(0.2, -0.1), amplitude=push)),
    )  # fmt: skip


def run(bench: Bench) -> None:
    """Both presets by the network, then by a table; the picture of docs/trust.md."""
    for preset in bench.pick(tuple(BORNE), ("printed",)):
        recipe = commands.made(commands.shipped(runs.RECIPES[preset], runs.folder(bench, preset)))
        study = recipe.study()
        surrogate = read_surrogate(study.training_path())
        rve = RveLaw(study.cell.parameters, recipe.rve)
        allowed = CacheSettings().tolerance * surrogate.stress_spread
        for kind in ("network", "table"):
            audited = above = 0
            for case in cases(preset, bench.pick(250.0, 10.0))[: None if kind == "network" else 4]:
                law: SurrogateLaw | StressTable = surrogate
                if kind == "table":
                    law = StressTable(rve, allowed, study.cell.range, surrogate.stress_spread)
                report = _audited(bench, f"trust.{preset}.{kind}", law, rve, case)
                audited += report["audited"]
                above += report["violations"]
            bench.add(f"trust.{preset}.{kind}.audited", audited, "", "answers, each audited")
            bench.add(f"trust.{preset}.{kind}.above", above, "", "of these above the tolerance",
                      at_most=0.0 if kind == "network" else 0.01 * audited)  # fmt: skip
    if not bench.quick:
        picture(read() | bench.figures, PICTURE)


def _audited(
    bench: Bench, name: str, law: SurrogateLaw | StressTable, rve: RveLaw, case: Case
) -> Mapping[str, float]:
    cached = CachedLaw(law, rve, CacheSettings(audit=1.0))
    full = simulate(case.problem, rve, case.macro)
    for _ in range(2 if isinstance(law, StressTable) else 1):
        cached.reset_counts()
        done = simulate(case.problem, cached, case.macro)
    report = cached.report()
    audit, allowed = report["audit"], report["tolerance"]["absolute"]
    most = None if isinstance(law, StressTable) else 1.0  # 99 % of a table's answers keep it
    bench.add(f"{name}.{case.name}.worst", audit["largest"] / allowed, "",
              f"{case.words}: largest error over tolerance", at_most=most)  # fmt: skip
    error = 100.0 * difference(done.curve, full.curve).largest
    bench.add(f"{name}.{case.name}.displacement", error, "%",
              f"{case.words}: largest difference in displacement", at_most=0.1)  # fmt: skip
    figures: Mapping[str, float] = audit
    return figures


def shown(figures: Mapping[str, Figure]) -> dict[str, float]:
    """What the picture shows: largest error over tolerance of each case by the network."""
    return {
        name: figures[name].value
        for preset in BORNE
        for case in cases(preset)
        if (name := f"trust.{preset}.network.{case.name}.worst") in figures
    }


def digest(values: Mapping[str, float]) -> str:
    """By which a picture states the figures that it was drawn from."""
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:16]


def picture(figures: Mapping[str, Figure], path: Path) -> None:
    """Largest error over tolerance of each case, on a logarithmic axis."""
    values = shown(figures)
    with mpl.rc_context({"font.size": 10, "axes.spines.top": False, "axes.spines.right": False}):
        chart = Picture(figsize=(7.0, 3.2), layout="constrained")
        axes = chart.add_subplot()
        words = [case.words for case in cases("printed")]
        for offset, preset, colour in ((-0.15, "printed", BLUE), (0.15, "water", VERMILION)):
            here = [
                values.get(f"trust.{preset}.network.{case.name}.worst", np.nan)
                for case in cases(preset)
            ]
            at = np.arange(len(here)) + offset
            axes.plot(here, at, "o", color=colour, label=f"preset {preset}")
        axes.axvline(1.0, color="0.3", linestyle="--")
        axes.annotate(
            "tolerance", (1.0, 0.0), (-4, 0), textcoords="offset points", ha="right", color="0.3"
        )
        axes.set(xscale="log", xlabel="largest error of all audited answers / tolerance")
        axes.set_yticks(range(len(words)), words)
        axes.invert_yaxis()
        axes.legend(loc="lower left", frameon=False)
        chart.savefig(path, dpi=300, metadata={"Description": digest(values)})


def picture_digest(path: Path = PICTURE) -> str:
    """The digest that a picture states; empty where it states none."""
    with Image.open(path) as image:
        return str(image.info.get("Description", ""))

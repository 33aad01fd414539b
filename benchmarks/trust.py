"""Does the cache keep its tolerance? Every accepted answer of each bar audited.

At a tolerance of 1e-3 of the spread of stress: the bar as it ships, under twice and three times
its body force, of other proportions and mesh, under a sideways push that reverses, for which
nothing was trained, pulled along its length by loads down to a thousandth, and pushed. A full run
writes docs/trust.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import isfinite, nan
from typing import Any

import numpy as np

from benchmarks.report import Outcome, make_report, to_markdown
from benchmarks.row import Row
from benchmarks.setting import ROOT, Array, Setting, rve
from benchmarks.timing import all_cores
from surrofe2 import CachedLaw, LoadCase, MacroSettings, simulate
from surrofe2.base.errors import SimulationError
from surrofe2.base.sampling import SamplingRange, sample
from surrofe2.base.tensors import stress_error
from surrofe2.cache import CacheSettings, StressTable
from surrofe2.cache.protocols import Surrogate
from surrofe2.macro import MacroRun
from surrofe2.problem import Problem
from surrofe2.run.displacement_curve import difference
from surrofe2.store.store import write_json, write_text

TITLE = "The cache against its tolerance, every accepted answer audited"
TOLERANCE = 1e-3
PRESETS = ("printed", "water")
BORNE = {"printed": 60.0, "water": 20.0}
"""µs under three times its body force: true FE² with `printed` ends at 69.6 µs, at F₂₁ = −0.31;
with `water` trials fail from 20.2 µs on, and it ends at 26.6."""


@dataclass(frozen=True, slots=True)
class Case:
    """A bar; hits: least share of the points within the range of the data, or of all points.

    trained: for surrogates that were trained alone.
    """

    name: str
    load: Problem
    macro: MacroSettings = MacroSettings()  # noqa: RUF009 - frozen
    hits: float = 0.95
    of_all: bool = False
    trained: bool = False


def cases(preset: str, duration: float) -> tuple[Case, ...]:
    """The bars that a surrogate of the default recipe is tried on, each for so long at most."""
    borne = BORNE[preset]
    usual = {"duration": duration}
    x, y = 0.0, -0.2
    push = tuple((t * duration, a) for t, a in ((0.0, 0.0), (0.1, 1.0), (0.4, 1.0), (0.6, -1.0)))
    return (
        Case("default bar", LoadCase(**usual), hits=0.99),
        Case("twice the body force", LoadCase(**usual, body_force=(2.0 * x, 2.0 * y))),
        Case(
            f"three times the body force, {borne:g} µs",
            LoadCase(body_force=(3.0 * x, 3.0 * y), duration=min(duration, borne)),
        ),
        Case(
            "500 × 300 µm, 10 × 6 elements",
            LoadCase(**usual, width=500.0, height=300.0, watched=(500.0, 150.0), elements=(10, 6)),
        ),
        *(
            Case(
                "pulled along x" + (f", {factor:g} of the load" if factor < 1.0 else ""),
                LoadCase(**usual, body_force=(-factor * y, 0.0)),
                MacroSettings(absolute_tolerance=1e-5 * factor),
                hits=0.99,
                trained=True,
            )
            for factor in (1.0, 0.1, 0.01, 0.001)
        ),
        *(
            Case(
                "pushed along x" + (f", {factor:g} times the load" if factor > 1.0 else ""),
                LoadCase(**usual, body_force=(factor * y, 0.0)),
                hits=0.99,
                trained=True,
            )
            for factor in (1.0, 1.5)
        ),
        Case(
            "sideways push that reverses",
            LoadCase(**usual, body_force=(0.2, -0.1), amplitude=push),
        ),
    )


@dataclass(frozen=True, slots=True)
class Subject:
    """A surrogate to be tried; runs: of one case, the last of which counts, for one that learns."""

    name: str
    make: Callable[[Setting, str], Surrogate]
    runs: int = 1
    hits: float | None = None


def _table(setting: Setting, preset: str) -> StressTable:
    spread, law = setting.surrogate(preset).stress_spread, rve(preset)
    return StressTable(law, TOLERANCE * spread, setting.recipe(preset).range, spread)


SUBJECTS = (
    Subject("network", lambda setting, preset: setting.surrogate(preset)),
    Subject("table, second run", _table, runs=2, hits=0.80),
)


def run(setting: Setting) -> list[Row]:
    """Every case by each subject for each preset; the table of docs/trust.md."""
    rows, reports = [], []
    for preset in setting.pick(PRESETS, PRESETS[:1]):
        for subject in SUBJECTS:
            for case in cases(preset, setting.pick(250.0, 10.0)):
                learns = subject.hits is not None
                if case.trained and learns:
                    continue
                settings = CacheSettings(tolerance=TOLERANCE, audit=1.0)
                law = CachedLaw(subject.make(setting, preset), rve(preset), settings)
                least = replace(case, hits=subject.hits or case.hits, of_all=learns)
                name = f"{preset}, {subject.name}, {case.name}"
                try:
                    found, report = measure(name, law, least, subject.runs, full=not setting.quick)
                except SimulationError as error:
                    rows.append(Row(name=name, value=None, unit="", note=f"no true run: {error}"))
                    continue
                rows += found
                reports.append(report)
    outcome = Outcome("trust", TITLE, rows)
    write_json(setting.out / "trust.json", {"cases": reports})
    if not setting.quick:
        report = make_report([outcome], quick=False, load=0.0)
        path = ROOT / "docs" / "trust.md"
        searched = path.read_text(encoding="utf-8").partition(SEARCH)
        page = to_page(report, outcome, reports) + bound_section(setting)
        write_text(path, with_search(page, "".join(searched[1:])))
    return rows


def measure(
    name: str, law: CachedLaw, case: Case, runs: int = 1, *, full: bool = True
) -> tuple[list[Row], dict[str, Any]]:
    """The case by the law and by its fallback alone: figures with limits, the cache's report."""
    true = simulate(case.load, law.fallback, case.macro)
    for _ in range(runs):
        law.reset_counts()
        cached = simulate(case.load, law, case.macro)
    report = {"case": name, **law.report()}
    return rows_of(name, case, true, cached, report, full=full), report


def rows_of(
    name: str,
    case: Case,
    true: MacroRun,
    cached: MacroRun,
    report: Mapping[str, Any],
    *,
    full: bool = True,
) -> list[Row]:
    """What must hold of one case; without a tolerance, which is infinite, nothing is held."""
    audit, accepted = report["audit"], report["accepted"]
    allowed = report["tolerance"]["absolute"]
    error = audit["quantiles"].get("0.99", nan) / allowed if isfinite(allowed) else nan
    points = accepted["hits"] + accepted["fallbacks"]
    calls = [done.counts["right_hand_sides"] for done in (cached, true)]
    stuck = true.counts["failed_trials"]
    displacement = difference(cached.curve, true.curve).largest
    events = "; ".join(event["finding"] for event in report["trust"]["events"])
    return [
        Row(
            name=f"{name}: error that 99 % of the accepted answers keep / tolerance",
            value=error,
            unit="",
            limit=1.0,
            threads=all_cores(),
            note=f"{audit['violations']} of {audit['audited']:,} above; {events or 'none failed'}",
        ),
        Row(
            name=f"{name}: hits of {'all' if case.of_all else 'the'} points"
            f"{'' if case.of_all else ' within the range'}",
            value=100.0
            * accepted["hits"]
            / max(points if case.of_all else accepted["in_domain"], 1),
            unit="%",
            limit=100.0 * case.hits,
            at_least=True,
            threads=all_cores(),
            note=f"{accepted['fallbacks']:,} points by RVEs, "
            f"{accepted['fallbacks_out_of_range']:,} out of range",
        ),
        Row(
            name=f"{name}: right-hand sides / those of true FE²",
            value=calls[0] / calls[1],
            unit="",
            limit=None if stuck else 1.05,
            threads=all_cores(),
            note=f"{calls[0]:,}, {cached.counts['repeated_steps']} steps begun anew"
            + (f"; {stuck} trials of true FE² have no stress, so no limit" if stuck else ""),
        ),
        Row(
            name=f"{name}: displacement error",
            value=100.0 * displacement,
            unit="%",
            limit=0.1 if full and case.hits > 0.95 else None,
            threads=all_cores(),
        ),
    ]


def to_page(report: Mapping[str, Any], outcome: Outcome, reports: list[dict[str, Any]]) -> str:
    """docs/trust.md: the limits, then the distribution of the errors incurred."""
    table = to_markdown(report, [outcome]).split("\n## ")
    head = (
        "# The cache against its tolerance\n\n"
        "This page shows how large the errors of the cache are against its tolerance, which is "
        f"{TOLERANCE:g} of the spread of stress and, by the network, at most "
        f"{CacheSettings().relative:g} of the local stress. A true RVE audited every "
        "accepted answer.\n\n"
        "Written by `make accept-cache`; do not edit. "
        f"surrofe2 {report['version']}, {report['date'][:10]}.\n"
    )
    lines = [
        "| case | audited | above | 50 % | 90 % | 99 % | 99.9 % | largest | worst at F | Ḟ |",
        "|" + " --- |" * 10,
        *(_distribution(each) for each in reports),
    ]
    return (
        f"{head}\n## {table[1]}\n## Errors incurred\n\nQuantiles of the errors relative to the "
        "tolerance, and where the largest was.\n\n" + "\n".join(lines) + "\n"
    )


FINE = 1e-4
SEARCH = "## What a search finds"
"""Heading of the section that `climb` writes."""
_CORNERS = 20_000


def bound_section(setting: Setting) -> str:
    """The part of docs/trust.md on the bound itself: what it lets through."""
    fine = [f"| preset | hits of the default bar at {FINE:g} | corners over |"]
    fine += ["|" + " --- |" * 3]
    for preset in PRESETS:
        surrogate, law = setting.surrogate(preset), rve(preset)
        cached = CachedLaw(surrogate, law, CacheSettings(tolerance=FINE))
        simulate(LoadCase(), cached, MacroSettings(frames=2))
        counts, spread = cached.counts, surrogate.stress_spread
        F, F_dot = _corners(surrogate.range)
        stress, status, bound = surrogate.lookup(F, F_dot, TOLERANCE * spread)
        kept = status == 0
        error = stress_error(stress[kept], law.respond(F[kept], F_dot[kept]).stress)
        hits = counts["hits"] / (counts["hits"] + counts["fallbacks"])
        shares = 100.0 * (error > bound[kept])
        now = f"{shares.mean():.2f} %" if len(shares) else "none accepted"
        fine += [f"| {preset} | {100.0 * hits:.1f} % | {now} |"]
    return (
        "\n## The bound against the true error\n\nA tolerance of "
        f"{FINE:g} is a tenth of the default one. Corners are states within a tenth of the bounds "
        "of all stretches; of those accepted at the default tolerance, so many have an error above "
        "their bound.\n\n" + "\n".join(fine) + "\n"
    )


def _corners(range: SamplingRange) -> tuple[Array, Array]:
    """States whose three stretches are all within the outer tenth of their half width."""
    F, F_dot = sample(range, _CORNERS, seed=99)
    rng, (low, high) = np.random.default_rng(99), range.stretch
    x = rng.choice([-1.0, 1.0], (_CORNERS, 3)) * rng.uniform(0.9, 1.0, (_CORNERS, 3))
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    x = np.array([middle, middle, 0.0]) + np.array([half, half, range.shear]) * x
    return x[:, [0, 2, 2, 1]].reshape(F.shape), F_dot


def with_search(page: str, section: str) -> str:
    """docs/trust.md with another section on what a search finds, which is the last."""
    kept = page.partition(SEARCH)[0].rstrip("\n")
    return f"{kept}\n\n{section}" if section else f"{kept}\n"


def _distribution(report: Mapping[str, Any]) -> str:
    audit, allowed = report["audit"], report["tolerance"]["absolute"]
    quantiles = [f"{value / allowed:.2g}" for value in audit["quantiles"].values()] or ["–"] * 4
    worst = audit["worst"]
    cells = [
        report["case"],
        f"{audit['audited']:,}",
        str(audit["violations"]),
        *quantiles,
        "–" if worst is None else f"{audit['largest'] / allowed:.2g}",
        "–" if worst is None else _entries(worst["F"]),
        "–" if worst is None else _entries(worst["F_dot"]),
    ]
    return f"| {' | '.join(cells)} |"


def _entries(tensor: list[list[float]]) -> str:
    return ", ".join(f"{entry:.3g}" for row in tensor for entry in row)

"""The picture of a comparison: displacements, their differences, audits, and the table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.plant_cell.parameters import PRESETS
from surrofe2.report.comparison import Comparison, order_runs
from surrofe2.report.figures import Curve, Panel, write_figure
from surrofe2.store.run_folder import StoredRun, caches_of

_BINS_A_DECADE = 10
_SEEN = 0.02
"""Share of the largest displacement from which on a component has a panel."""
_MOST_NAMED = 3


def write_comparison_plot(path: Path, comparison: Comparison, runs: Sequence[StoredRun]) -> None:
    """Draw displacement curves, their differences, audits and the table into a PNG."""
    panels = [*displacement_panels(runs), *difference_panels(runs), *audit_panels(runs)]
    write_figure(path, comparison_title(runs), panels, table=comparison.table)


def displacement_panels(runs: Sequence[StoredRun]) -> list[Panel]:
    """The watched point's displacement by all runs, each component that counts in a panel."""
    reference, *others = order_runs(runs) if len(runs) > 1 else runs
    there = abs(reference.curve.displacement).max(axis=0)
    panels: list[Panel] = []
    for axis in np.argsort(-there).tolist():
        if panels and there[axis] < _SEEN * there.max():
            continue
        curves = tuple(
            Curve(
                "" if k else "reference",
                run.curve.t,
                run.curve.displacement[:, axis],
                _label(run, reference),
                markers=False,
                colour=k - 1,
            )
            for k, run in enumerate((reference, *others))
        )
        label, height = f"displacement $u_{'xy'[axis]}$ (µm)", 0.55 if panels else 1.0
        panels.append(Panel(clock_of(reference), label, curves, height=height))
    return panels


def difference_panels(runs: Sequence[StoredRun]) -> list[Panel]:
    """How far each run's displacement is from the reference's, a share of the largest."""
    reference, *others = order_runs(runs)
    t, there = reference.curve.t, reference.curve.displacement
    scale = np.linalg.norm(there, axis=1).max() or 1.0
    differences = []
    for k, run in enumerate(others):
        u = run.curve.displacement
        apart = [u[:, i] - np.interp(run.curve.t, t, there[:, i]) for i in range(2)]
        share = 100.0 * np.linalg.norm(apart, axis=0) / scale
        label = _label(run, reference)
        differences.append(Curve("", run.curve.t, share, label, markers=False, colour=k))
    label = "difference (% of\nlargest displacement)"
    return [Panel(clock_of(reference), label, tuple(differences), height=0.55)]


def audit_panels(runs: Sequence[StoredRun]) -> list[Panel]:
    """Errors of the caches' stress found by audits; none without audits."""
    audits: list[Curve] = []
    for k, run in enumerate(order_runs(runs)[1:] if len(runs) > 1 else runs):
        for cache in caches_of(run.record.cache).values():
            if cache["audit"]["quantiles"]:
                audits += audit_curves(k, cache["audit"])
    if not audits:
        return []
    label = "error of the cache's stress found by audits (µN/µm)\ndotted: 99 % are below"
    panel = Panel(label, "audited\nanswers (%)", tuple(audits), log_x=True, zero=True, height=0.55)
    return [panel]


def clock_of(run: StoredRun) -> str:
    """What a run's curves are over."""
    return "factor of the load" if "rest" in run.record.recipe else "time $t$ (µs)"


def comparison_title(runs: Sequence[StoredRun]) -> str:
    """Watched point, problem, cell, and the initialisation that the runs have in common."""
    reference = (order_runs(runs) if len(runs) > 1 else runs)[0]
    recipe = reference.record.recipe
    notes = [cell_title(recipe), _usual(reference)]
    details = ", ".join(filter(None, notes))
    return f"{watched_title(reference)}: {problem_title(recipe)}" + (details and f",\n{details}")


def watched_title(run: StoredRun) -> str:
    """The first watched point by its position, and its name where it has one."""
    watched = run.record.problem.get("watched") or run.record.recipe.get("watch", {})
    for name, at in watched.items():
        if at:
            label = "" if name == "point" else f" “{name}”"
            return f"Watched point{label} ({at[0]:g}, {at[1]:g}) µm"
    return "Watched point"


def cell_title(recipe: Mapping[str, Any]) -> str:
    """The preset of each cell, with the constants that are not the preset's."""
    cells = {"": recipe["cell"]} if "cell" in recipe else recipe.get("cells", {})
    titles = []
    for name, cell in cells.items():
        preset = str(cell.get("preset", "none"))
        known = PRESETS[preset].to_dict() if preset in PRESETS else {}
        changed = [f"{key} {cell[key]}" for key in known if cell.get(key, known[key]) != known[key]]
        if len(changed) > _MOST_NAMED:
            changed = [*changed[:_MOST_NAMED], f"{len(changed) - _MOST_NAMED} more constants"]
        but = f" but {', '.join(changed)}" if changed else ""
        titles.append(f"cell {name and name + ' '}by preset “{preset}”{but}")
    return ", ".join(titles)


def _usual(reference: StoredRun) -> str:
    """The reference's initialisation; of a full tissue none."""
    known = reference.record.initialisation
    return "" if known == "none" else known


def _label(run: StoredRun, reference: StoredRun) -> str:
    """The folder, and what differs from the title's cell and initialisation."""
    record, usual = run.record, reference.record
    notes = [] if run.folder.name == record.law else [record.law]
    if cell_title(record.recipe) != cell_title(usual.recipe):
        notes.append(cell_title(record.recipe))
    if record.initialisation not in ("none", usual.initialisation):
        notes.append(record.initialisation)
    return f"{run.folder.name} ({', '.join(notes)})" if notes else run.folder.name


def audit_curves(k: int, audit: Mapping[str, Any]) -> list[Curve]:
    """Share of run k's audited answers over their error, its 99 % quantile and the tolerance."""
    edges, shares = coarse_histogram(audit["histogram"])
    high = np.array([0.0, 100.0 * shares.max()])

    def line(x: float, dash: str, label: str = "") -> Curve:
        return Curve("", np.full(2, x), high, label, markers=False, colour=k, dash=dash)

    percent = np.concatenate([[0.0], 100.0 * shares])
    curves = [Curve("", edges, percent, markers=False, colour=k, dash="-", steps=True)]
    curves.append(line(audit["quantiles"]["0.99"], ":"))
    if np.isfinite(tolerance := float(audit["tolerance"])):
        above = f"tolerance: {audit['violations']} of {audit['audited']:,} above"
        curves.append(line(tolerance, "--", above))
    return curves


def coarse_histogram(histogram: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """(b + 1,) edges and (b,) shares of a stored histogram in ten bins a decade."""
    fine, counts = np.array(histogram["bins"]), np.array(histogram["counts"], dtype=np.float64)
    many = histogram["bins_a_decade"] // _BINS_A_DECADE
    # Fine bin k ends at the smallest edge times 10^(k / bins a decade).
    coarse = -(-fine // many)
    first, last = coarse.min(), coarse.max()
    shares = np.bincount(coarse - first, weights=counts) / counts.sum()
    powers = np.arange(first - 1, last + 1) / _BINS_A_DECADE
    return histogram["smallest_edge"] * 10.0**powers, shares


def problem_title(recipe: Mapping[str, Any]) -> str:
    """What a run computes, in a line: the bar, or the mesh and all that acts on it."""
    mesh, conditions, bodies = recipe["mesh"], recipe["conditions"], recipe["bodies"]
    acting = [*conditions, *bodies]
    if mesh.get("file"):
        return f"{mesh['file']}: {', '.join(acting)}"
    number = mesh["elements"]  # one number where the mesh was made in Python
    elements = f"{number if isinstance(number, int) else '{} × {}'.format(*number)} elements"
    of = f"{mesh['width']:g} × {mesh['height']:g} µm"
    if acting == ["clamp", "load"] and "acceleration" in conditions["load"]:
        g_x, g_y = (f"{g:g}".replace("-", "−") for g in conditions["load"]["acceleration"])
        return f"{of} tissue, body force ({g_x}, {g_y}) µm/µs², {elements}"
    return f"{of}, {elements}: {', '.join(acting)}"

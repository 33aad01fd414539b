"""A parameter study: its table, and its picture over the first of the values that change."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.units import NONE
from surrofe2.recipe.entries import text_of
from surrofe2.recipe.recipe import SECTIONS
from surrofe2.report.chosen import Chosen, peaks_of
from surrofe2.report.comparison import BUCKLED, compared_run
from surrofe2.report.tables import Quantity, Table, percent
from surrofe2.run.charts import Curve, Panel, draw_panels, encoded, in_words
from surrofe2.store.run_folder import StoredRun, caches_of
from surrofe2.store.store import write_bytes

_MOST_CURVES = 12
"""Of displacements over time that are drawn; more are not told apart."""
_SAME = 1e-3
"""Of the largest displacement: one that varies less is prescribed."""
_DECADE = 10.0
"""Positive values that are so many times apart stand on a logarithm."""

Facts = Mapping[str, Any]


class GridRow(NamedTuple):
    """A run of a grid, None where it failed, and what is known of it.

    `facts` are the values of the entries that change and that it depends on, by dotted name, what
    the columns of `QUANTITIES` show, the "law", and the "tolerance" of its cache over the spread of
    stress.
    """

    facts: Facts
    run: StoredRun | None


def grid_row(
    values: Mapping[str, Any],
    law: str,
    name: str,
    run: StoredRun | None,
    true: StoredRun | None,
    error: str | None,
    chosen: Sequence[Chosen] = (),
) -> GridRow:
    """A row; true: the run of the same values by RVEs, if there is one; chosen: what is asked of
    the run besides, where nothing is the peaks of its forces."""
    facts: dict[str, Any] = {**values, "law": law, "run": name, "error": error}
    if run is None:
        return GridRow(facts, run)
    counts, caches = run.record.counts, [*caches_of(run.record.cache).values()]
    facts |= {
        "largest displacement": float(np.linalg.norm(run.curve.displacement, axis=1).max()),
        "wall time": run.record.wall_time["total"],
        "beyond a bifurcation": run.record.met.get(BUCKLED, {}).get("points") or None,
        "RVE solves": counts.get("rve_solves", 0),
    }
    for each in chosen or peaks_of(run):
        facts[each.name], facts[f"unit of {each.name}"] = each.of(run)
    computed = counts.get("hits", 0) + counts.get("fallbacks", 0)
    if computed:
        facts["hits"] = counts["hits"] / computed
    if caches:  # of several the worst
        audits = [cache["audit"] for cache in caches]
        wrong, audited = (sum(audit[k] for audit in audits) for k in ("violations", "audited"))
        facts |= {
            "tolerance": max(float(cache["tolerance"]["share"]) for cache in caches),
            "above": f"{wrong} of {audited}",
            "switched off": any(cache["trust"]["off"] for cache in caches) or None,
        }
    errors = [
        cache["audit"]["quantiles"]["0.99"] / cache["tolerance"]["spread"]
        for cache in caches
        if cache["audit"]["quantiles"] and cache["tolerance"]["spread"]
    ]
    facts["stress error"] = max(errors, default=None)
    if true is not None and law != "rve":
        against = compared_run(run, true)
        facts |= {
            "displacement error": against.difference.largest,
            "speed-up": against.speed_up["wall_time"],
            "all counted": against.balance and against.balance.gain,
        }
    return GridRow(facts, run)


QUANTITIES: tuple[Quantity[Facts], ...] = (
    Quantity("largest displacement", "µm", ".5g"),
    Quantity("displacement error", "", percent(2)),
    Quantity("stress error", "", percent(2)),
    Quantity("above", "", None),
    Quantity("hits", "", percent(3)),
    Quantity("wall time", "s", ".3g"),
    Quantity("speed-up", "×", ".3g"),
    Quantity("all counted", "×", ".3g"),
    Quantity("RVE solves", "", None),
    Quantity("beyond a bifurcation", "points", None),
    Quantity("switched off", "", lambda off: "yes"),
    Quantity("run", "", None),
    Quantity("error", "", lambda message: "failed"),
)
"""The stress error is what 99 % of the audited answers keep, relative to the spread of stress."""


@dataclass(frozen=True, slots=True)
class Grid:
    """Runs of a recipe, called so, by the values of its entries."""

    recipe: str
    values: Mapping[str, tuple[Any, ...]]
    rows: tuple[GridRow, ...]

    @property
    def has_laws(self) -> bool:
        """Whether there are runs by more than one law."""
        return len({row.facts["law"] for row in self.rows}) > 1

    @property
    def table(self) -> Table[Facts]:
        """What people read of it."""
        naming = [_of_entry(name, self.values) for name in self.values]
        naming += [Quantity("law", "", "")] * self.has_laws
        known = {fact for row in self.rows for fact in row.facts}
        shown = (  # either seconds or how many times faster: a line has 80 columns
            replace(each, format=None) if each.name == "wall time" and "speed-up" in known else each
            for each in QUANTITIES
        )
        asked: list[Quantity[Facts]]
        asked = [Quantity(name, unit, ".5g") for name, unit in self.asked.items()]
        return Table((*naming, *asked, *shown), [row.facts for row in self.rows], len(naming))

    @property
    def asked(self) -> dict[str, str]:
        """Units of the quantities that were asked of the runs, by name."""
        begin = "unit of "
        units: dict[str, str] = {}
        for row in self.rows:
            for fact, unit in row.facts.items():
                if fact.startswith(begin):
                    units[fact.removeprefix(begin)] = unit or units.get(
                        fact.removeprefix(begin), ""
                    )
        return units

    @property
    def failed(self) -> dict[str, str]:
        """Error messages by name of the run."""
        return {row.facts["run"]: row.facts["error"] for row in self.rows if row.facts["error"]}

    def to_dict(self) -> dict[str, Any]:
        """Plain values for grid.json."""
        return {
            "recipe": self.recipe,
            "values": self.values,
            "units": self.table.units,
            "rows": self.table.to_records(),
        }


def _short(name: str, among: Iterable[str]) -> str:
    """An entry without its section, where no other is called so."""
    key = name.partition(".")[2]
    return key if sum(other.partition(".")[2] == key for other in among) == 1 else name


def _of_entry(name: str, among: Iterable[str]) -> Quantity[Facts]:
    """The column of an entry."""
    section, *parts = name.split(".")
    if section == "cells":
        section, parts = "cell", parts[1:]
    items = fields(SECTIONS[section]) if section in SECTIONS else ()
    units = [each.metadata.get("unit", NONE) for each in items if each.name == parts[0]]
    unit = next((each for each in units if each != NONE), "")

    def get(facts: Facts) -> Any:
        value = facts.get(name)
        return value if value is None or _is_number(value) else text_of(value)

    def shown(value: Any) -> str:
        return value if isinstance(value, str) else f"{value:g}"

    return Quantity(_short(name, among), unit, shown, get)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


_PANELS = (
    ("largest displacement", "largest displacement (µm)", False),
    ("displacement error", "displacement error\n/ largest displacement", True),
    ("stress error", "stress error\n/ spread of stress", True),
    ("hits", "stresses from the cache (1)", False),
    ("speed-up", "times faster than full FE²", False),
    ("wall time", "wall time (s)", False),
)
"""Quantities that are drawn over the values, label of their axis, and whether it is logarithmic."""


def write_grid_plot(path: Path, grid: Grid) -> None:
    """Draw displacements over time, and what runs came to over the first entry that changes."""
    law = grid.rows[0].facts["law"]
    changing = [name for name, values in grid.values.items() if len(values) > 1]

    def words(facts: Facts, names: Sequence[str]) -> str:
        known = [name for name in names if name in facts]
        return ", ".join(f"{_short(name, grid.values)} {text_of(facts[name])}" for name in known)

    panels: list[Panel] = []
    finished = [  # the curves of other laws would lie on those of the first
        (words(row.facts, changing) or law, row.run.curve)
        for row in grid.rows
        if row.run is not None and row.facts["law"] == law
    ]
    if finished:
        some = np.linspace(0, len(finished) - 1, min(len(finished), _MOST_CURVES)).round()
        shown = [finished[int(k)] for k in np.unique(some)]
        sizes = np.array([abs(curve.displacement).max(axis=0) for _, curve in shown])
        axis = int(sizes.max(axis=0).argmax())  # the larger component of the watched displacement
        lines = (
            Curve("", curve.t, curve.displacement[:, axis], label, markers=False)
            for label, curve in shown
        )
        clock = next(row.run.clock for row in grid.rows if row.run is not None)
        panels.append(Panel(clock, f"displacement $u_{'xy'[axis]}$ (µm)", tuple(lines)))
    groups: dict[str, list[Facts]] = {}
    for facts, _ in grid.rows if changing else ():
        if changing[0] in facts:
            parts = words(facts, changing[1:]), facts["law"] if grid.has_laws else ""
            groups.setdefault(", ".join(filter(None, parts)) or grid.recipe, []).append(facts)
    if groups:
        panels += _over_values(grid, changing[0], groups)
    spans = ([text_of(each) for each in values] for values in grid.values.values())
    ends = (span[0] if len(span) == 1 else f"{span[0]} … {span[-1]}" for span in spans)
    of = ", ".join(f"{name} {span}" for name, span in zip(grid.values, ends, strict=True))
    figure = draw_panels(panels, 2, title=f"{grid.recipe}: {of}")
    write_bytes(path, encoded(figure, "png"))


def map_of(grid: Grid) -> tuple[str, Array] | None:
    """What a map over two entries shows, and its values (n, m), NaN where a run failed; None where
    not exactly two entries change, or there are runs by several laws."""
    changing = [name for name, values in grid.values.items() if len(values) > 1]
    if len(changing) != 2 or grid.has_laws:
        return None
    first, second = changing
    name = next(iter(grid.asked), "largest displacement")
    unit = grid.asked.get(name, "µm")
    places = [{text_of(each): k for k, each in enumerate(grid.values[entry])} for entry in changing]
    found = np.full((len(places[0]), len(places[1])), np.nan)
    for facts, _ in grid.rows:
        value = facts.get(name)
        if value is not None:
            found[places[0][text_of(facts[first])], places[1][text_of(facts[second])]] = value
    return (f"{name} ({unit})" if unit else name), found


def write_grid_map(path: Path, grid: Grid) -> bool:
    """Draw a quantity over the two entries that change, a field for each run; whether there are two
    such entries and it was drawn."""
    from matplotlib.figure import Figure

    shown = map_of(grid)
    if shown is None:
        return False
    label, values = shown
    first, second = [name for name, each in grid.values.items() if len(each) > 1]
    figure = Figure(figsize=(2.4 + 0.9 * values.shape[1], 2.2 + 0.5 * values.shape[0]))
    figure.set_layout_engine("constrained")
    axes = figure.subplots()
    image = axes.imshow(values, origin="lower", aspect="auto")
    for (i, j), value in np.ndenumerate(values):
        if np.isfinite(value):
            red, green, blue, _ = image.to_rgba(np.array(value))
            is_dark = 0.3 * red + 0.6 * green + 0.1 * blue < 0.5
            colour = "white" if is_dark else "black"
            axes.text(j, i, f"{value:.3g}", ha="center", va="center", fontsize=8, color=colour)
    for axis, name in ((axes.yaxis, first), (axes.xaxis, second)):
        axis.set_ticks(range(len(grid.values[name])), [text_of(each) for each in grid.values[name]])
        axis.set_label_text(in_words(_of_entry(name, grid.values).heading))
    figure.colorbar(image, label=in_words(label))
    write_bytes(path, encoded(figure, "png"))
    return True


def _is_prescribed(groups: Mapping[str, list[Facts]]) -> bool:
    """Whether the largest displacement is the same everywhere, as a prescribed one is."""
    found = [facts["largest displacement"] for rows in groups.values() for facts in rows
             if "largest displacement" in facts]  # fmt: skip
    return len(found) > 1 and float(np.ptp(found)) < _SAME * max(found)


def _over_values(grid: Grid, over: str, groups: Mapping[str, list[Facts]]) -> list[Panel]:
    """The quantities over an entry, whose values are marked one by one where they are no numbers;
    a curve for each group."""
    values = grid.values[over]
    are_numbers = all(map(_is_number, values))
    places = {text_of(each): float(each if are_numbers else k) for k, each in enumerate(values)}
    x_ticks, panels = [*places.values()], dict[str, Panel]()
    asked = [
        (name, f"{name} ({unit})" if unit else name, False) for name, unit in grid.asked.items()
    ]
    for name, y_label, log_y in (*asked, *_PANELS):
        if name == "largest displacement" and _is_prescribed(groups):
            continue
        curves = []
        for k, (label, rows) in enumerate(groups.items()):
            if name == "largest displacement" and rows[0]["law"] != grid.rows[0].facts["law"]:
                continue
            rows = sorted(rows, key=lambda facts: places[text_of(facts[over])])
            x = np.array([places[text_of(facts[over])] for facts in rows])
            y, tolerance = (
                np.array([facts.get(fact) for facts in rows], dtype=np.float64)  # None: NaN
                for fact in (name, "tolerance")
            )
            if not np.isnan(y).all():
                curves.append(Curve("", x, y, label, colour=k))
                if name == "stress error":
                    curves.append(Curve("reference", x, tolerance, "tolerance of stress"))
        if curves and not (name == "wall time" and "speed-up" in panels):
            panels[name] = Panel(
                _of_entry(over, grid.values).heading,
                y_label,
                tuple(curves),
                log_x=are_numbers and min(x_ticks) > 0.0 and max(x_ticks) > _DECADE * min(x_ticks),
                log_y=log_y,
                x_ticks=() if are_numbers else tuple(x_ticks),
                x_names=() if are_numbers else tuple(places),
                zero=not log_y and name != "largest displacement",
            )
    return [*panels.values()]

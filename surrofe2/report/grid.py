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

# Curves of displacement over time that are drawn; more could not be told apart.
_MOST_CURVES = 12
# A displacement that varies less over the grid, relative to the largest, is prescribed.
_SAME = 1e-3
# Positive values that are so many times apart have a logarithmic axis.
_DECADE = 10.0

Facts = Mapping[str, Any]


class GridRow(NamedTuple):
    """A run of a grid.

    Attributes:
        facts: values of the entries that change and that the run depends on, by dotted name; the
            values of the columns of `QUANTITIES`; the "law"; and the "tolerance" of its cache over
            the spread of stress.
        run: the run; None where it failed.
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
    """Make the row of a run.

    Args:
        values: values of the entries that change, by dotted name.
        run: None where it failed.
        true: the run of the same values by RVEs, if there is one.
        error: message of a run that failed.
        chosen: quantities that are asked of the run besides; none: the peaks of its forces.
    """
    facts: dict[str, Any] = {**values, "law": law, "run": name, "error": error}
    if run is None:
        return GridRow(facts, run)
    counts = run.record.counts
    caches = [*caches_of(run.record.cache).values()]
    facts |= {
        "largest displacement": float(np.linalg.norm(run.curve.displacement, axis=1).max()),
        "wall time": run.record.wall_time["total"],
        "beyond a bifurcation": run.record.met.get(BUCKLED, {}).get("points") or None,
        "RVE solves": counts.get("rve_solves", 0),
    }
    for quantity in chosen or peaks_of(run):
        value, unit = quantity.of(run)
        facts[quantity.name] = value
        facts[f"unit of {quantity.name}"] = unit
    computed = counts.get("hits", 0) + counts.get("fallbacks", 0)
    if computed:
        facts["hits"] = counts["hits"] / computed
    facts |= _facts_of_caches(caches)
    if true is not None and law != "rve":
        compared = compared_run(run, true)
        facts |= {
            "displacement error": compared.difference.largest,
            "speed-up": compared.speed_up["wall_time"],
            "all counted": compared.balance.gain if compared.balance else None,
        }
    return GridRow(facts, run)


def _facts_of_caches(caches: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the facts on the caches of a run; of several caches the worst."""
    errors = []
    for cache in caches:
        quantiles = cache["audit"]["quantiles"]
        spread = cache["tolerance"]["spread"]
        if quantiles and spread:
            errors.append(quantiles["0.99"] / spread)
    facts: dict[str, Any] = {}
    if caches:
        wrong = sum(cache["audit"]["violations"] for cache in caches)
        audited = sum(cache["audit"]["audited"] for cache in caches)
        facts["tolerance"] = max(float(cache["tolerance"]["share"]) for cache in caches)
        facts["above"] = f"{wrong} of {audited}"
        facts["switched off"] = any(cache["trust"]["off"] for cache in caches) or None
    facts["stress error"] = max(errors, default=None)
    return facts


# The columns. The stress error is what 99 % of the audited answers keep, relative to the spread of
# stress.
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


@dataclass(frozen=True, slots=True)
class Grid:
    """Runs of a recipe over a grid of values.

    Attributes:
        recipe: name of the recipe.
        values: values of each entry that the grid changes, by dotted name.
        rows: the runs.
    """

    recipe: str
    values: Mapping[str, tuple[Any, ...]]
    rows: tuple[GridRow, ...]

    @property
    def has_laws(self) -> bool:
        """True if there are runs by more than one law."""
        return len({row.facts["law"] for row in self.rows}) > 1

    @property
    def table(self) -> Table[Facts]:
        """The runs in a table, whose first columns name them."""
        naming = [_of_entry(name, self.values) for name in self.values]
        if self.has_laws:
            naming.append(Quantity("law", "", ""))
        asked: list[Quantity[Facts]]
        asked = [Quantity(name, unit, ".5g") for name, unit in self.asked.items()]
        has_speed_up = any("speed-up" in row.facts for row in self.rows)
        shown = []
        for quantity in QUANTITIES:
            if quantity.name == "wall time" and has_speed_up:
                # either seconds or how many times faster: a line has 80 columns
                quantity = replace(quantity, format=None)
            shown.append(quantity)
        return Table((*naming, *asked, *shown), [row.facts for row in self.rows], len(naming))

    @property
    def asked(self) -> dict[str, str]:
        """Units of the quantities that were asked of the runs, by name."""
        begin = "unit of "
        units: dict[str, str] = {}
        for row in self.rows:
            for fact, unit in row.facts.items():
                if fact.startswith(begin):
                    name = fact.removeprefix(begin)
                    # a run without the quantity does not know its unit
                    units[name] = unit or units.get(name, "")
        return units

    @property
    def failed(self) -> dict[str, str]:
        """Error messages by name of the run."""
        return {row.facts["run"]: row.facts["error"] for row in self.rows if row.facts["error"]}

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for grid.json."""
        return {
            "recipe": self.recipe,
            "values": self.values,
            "units": self.table.units,
            "rows": self.table.to_records(),
        }


def _short(name: str, among: Iterable[str]) -> str:
    """Return the name of an entry without its section, where no other of them is called so."""
    key = name.partition(".")[2]
    same = [other for other in among if other.partition(".")[2] == key]
    return key if len(same) == 1 else name


def _of_entry(name: str, among: Iterable[str]) -> Quantity[Facts]:
    """Return the column of an entry; its unit is that of the setting."""
    section, *parts = name.split(".")
    if section == "cells":  # cells.NAME.entry is an entry of a cell
        section = "cell"
        parts = parts[1:]
    unit = ""
    for item in fields(SECTIONS[section]) if section in SECTIONS else ():
        if item.name == parts[0] and item.metadata.get("unit", NONE) != NONE:
            unit = item.metadata["unit"]

    def get(facts: Facts) -> Any:
        """Return the value of a row: a number, a text, or None."""
        value = facts.get(name)
        if value is None or _is_number(value):
            return value
        return text_of(value)

    def shown(value: Any) -> str:
        """Write a value."""
        return value if isinstance(value, str) else f"{value:g}"

    return Quantity(_short(name, among), unit, shown, get)


def _is_number(value: Any) -> bool:
    """Return whether a value is a number; truths are none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


# Quantities that are drawn over the values: name, label of the axis, whether that is logarithmic.
_PANELS = (
    ("largest displacement", "largest displacement (µm)", False),
    ("displacement error", "displacement error\n/ largest displacement", True),
    ("stress error", "stress error\n/ spread of stress", True),
    ("hits", "stresses from the cache (1)", False),
    ("speed-up", "times faster than full FE²", False),
    ("wall time", "wall time (s)", False),
)


def write_grid_plot(path: Path, grid: Grid) -> None:
    """Draw displacements over time, and quantities over the first entry that changes."""
    changing = _changing(grid)
    panels: list[Panel] = []
    over_time = _over_time(grid, changing)
    if over_time is not None:
        panels.append(over_time)
    if changing:
        groups: dict[str, list[Facts]] = {}  # rows that differ in the first entry alone
        for facts, _ in grid.rows:
            if changing[0] in facts:
                label = _values_in_words(grid, facts, changing[1:])
                if grid.has_laws:
                    label = f"{label}, {facts['law']}" if label else facts["law"]
                groups.setdefault(label or grid.recipe, []).append(facts)
        if groups:
            panels += _over_values(grid, changing[0], groups)
    spans = []
    for name, values in grid.values.items():
        span = text_of(values[0])
        if len(values) > 1:
            span = f"{span} … {text_of(values[-1])}"
        spans.append(f"{name} {span}")
    figure = draw_panels(panels, 2, title=f"{grid.recipe}: {', '.join(spans)}")
    write_bytes(path, encoded(figure, path.suffix[1:]))


def _changing(grid: Grid) -> list[str]:
    """Return the entries that have more than one value."""
    return [name for name, values in grid.values.items() if len(values) > 1]


def _values_in_words(grid: Grid, facts: Facts, names: Sequence[str]) -> str:
    """Write the values that a row has of some entries."""
    values = [
        f"{_short(name, grid.values)} {text_of(facts[name])}" for name in names if name in facts
    ]
    return ", ".join(values)


def _over_time(grid: Grid, changing: Sequence[str]) -> Panel | None:
    """Draw the watched displacement of some runs over time; None where no run has ended.

    They are runs by the first law, for the curves of others would lie on theirs.
    """
    law = grid.rows[0].facts["law"]
    labelled = [
        (_values_in_words(grid, row.facts, changing) or law, row.run.curve)
        for row in grid.rows
        if row.run is not None and row.facts["law"] == law
    ]
    if not labelled:
        return None
    count = min(len(labelled), _MOST_CURVES)
    evenly = np.unique(np.linspace(0, len(labelled) - 1, count).round())
    shown = [labelled[int(k)] for k in evenly]
    largest = np.array([abs(curve.displacement).max(axis=0) for _, curve in shown])
    axis = int(largest.max(axis=0).argmax())  # the larger component of the watched displacement
    curves = tuple(
        Curve("", curve.t, curve.displacement[:, axis], label, markers=False)
        for label, curve in shown
    )
    clock = next(row.run.clock for row in grid.rows if row.run is not None)
    return Panel(clock, f"displacement $u_{'xy'[axis]}$ (µm)", curves)


def map_of(grid: Grid) -> tuple[str, Array] | None:
    """Return the label of a map over two entries, and its values (n, m), NaN where a run failed.

    There is no map (None) where not exactly two entries change, or there are several laws.
    """
    changing = _changing(grid)
    if len(changing) != 2 or grid.has_laws:
        return None
    first, second = changing
    name = next(iter(grid.asked), "largest displacement")
    unit = grid.asked.get(name, "µm")
    row_of = {text_of(value): i for i, value in enumerate(grid.values[first])}
    column_of = {text_of(value): j for j, value in enumerate(grid.values[second])}
    values = np.full((len(row_of), len(column_of)), np.nan)
    for facts, _ in grid.rows:
        value = facts.get(name)
        if value is not None:
            values[row_of[text_of(facts[first])], column_of[text_of(facts[second])]] = value
    label = f"{name} ({unit})" if unit else name
    return label, values


def write_grid_map(path: Path, grid: Grid) -> bool:
    """Draw a quantity over the two entries that change, a field for each run.

    Return whether it was drawn: there must be two such entries, see `map_of`.
    """
    from matplotlib.figure import Figure

    shown = map_of(grid)
    if shown is None:
        return False
    label, values = shown
    first, second = _changing(grid)
    figure = Figure(figsize=(2.4 + 0.9 * values.shape[1], 2.2 + 0.5 * values.shape[0]))
    figure.set_layout_engine("constrained")
    axes = figure.subplots()
    image = axes.imshow(values, origin="lower", aspect="auto")
    for (i, j), value in np.ndenumerate(values):
        if np.isfinite(value):
            red, green, blue, _ = image.to_rgba(np.array(value))
            # brightness as eyes see it
            is_dark = 0.3 * red + 0.6 * green + 0.1 * blue < 0.5
            colour = "white" if is_dark else "black"
            axes.text(j, i, f"{value:.3g}", ha="center", va="center", fontsize=8, color=colour)
    for axis, name in ((axes.yaxis, first), (axes.xaxis, second)):
        texts = [text_of(value) for value in grid.values[name]]
        axis.set_ticks(range(len(texts)), texts)
        axis.set_label_text(in_words(_of_entry(name, grid.values).heading))
    figure.colorbar(image, label=in_words(label))
    write_bytes(path, encoded(figure, path.suffix[1:]))
    return True


def _is_prescribed(groups: Mapping[str, list[Facts]]) -> bool:
    """Return whether the largest displacement is the same everywhere, as a prescribed one is."""
    displacements = []
    for rows in groups.values():
        for facts in rows:
            if "largest displacement" in facts:
                displacements.append(facts["largest displacement"])
    if len(displacements) < 2:
        return False
    return float(np.ptp(displacements)) < _SAME * max(displacements)


def _over_values(grid: Grid, over: str, groups: Mapping[str, list[Facts]]) -> list[Panel]:
    """Draw quantities over an entry, a curve for each group.

    Values that are no numbers are marked one by one.
    """
    values = grid.values[over]
    are_numbers = all(_is_number(value) for value in values)
    places = {text_of(value): float(value if are_numbers else k) for k, value in enumerate(values)}
    lowest = min(places.values())
    highest = max(places.values())
    is_wide = lowest > 0.0 and highest > _DECADE * lowest
    asked = [
        (name, f"{name} ({unit})" if unit else name, False) for name, unit in grid.asked.items()
    ]
    panels: dict[str, Panel] = {}
    for name, y_label, log_y in (*asked, *_PANELS):
        if name == "largest displacement" and _is_prescribed(groups):
            continue
        if name == "wall time" and "speed-up" in panels:  # one says what the other does
            continue
        curves = _curves_over_values(grid, over, groups, places, name)
        if curves:
            panels[name] = Panel(
                _of_entry(over, grid.values).heading,
                y_label,
                tuple(curves),
                log_x=are_numbers and is_wide,
                log_y=log_y,
                x_ticks=() if are_numbers else tuple(places.values()),
                x_names=() if are_numbers else tuple(places),
                zero=not log_y and name != "largest displacement",
            )
    return [*panels.values()]


def _curves_over_values(
    grid: Grid,
    over: str,
    groups: Mapping[str, list[Facts]],
    places: Mapping[str, float],
    name: str,
) -> list[Curve]:
    """Return the curves of one quantity over an entry, one for each group that has it.

    Args:
        over: name of the entry.
        groups: rows by the label of their curve.
        places: place on the axis of each value of the entry, by its text.
        name: name of the quantity.
    """
    curves = []
    first_law = grid.rows[0].facts["law"]
    for k, (label, rows) in enumerate(groups.items()):
        # displacements by other laws would lie on those by the first
        if name == "largest displacement" and rows[0]["law"] != first_law:
            continue
        in_order = sorted(rows, key=lambda facts: places[text_of(facts[over])])
        x = np.array([places[text_of(facts[over])] for facts in in_order])
        y = np.array([facts.get(name) for facts in in_order], dtype=np.float64)  # None: NaN
        if np.isnan(y).all():
            continue
        curves.append(Curve("", x, y, label, colour=k))
        if name == "stress error":
            tolerance = [facts.get("tolerance") for facts in in_order]
            y_tolerance = np.array(tolerance, dtype=np.float64)
            curves.append(Curve("reference", x, y_tolerance, "tolerance of stress"))
    return curves

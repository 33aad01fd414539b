"""A look into the plant cells of a run: one point over time, or extremes of all elements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, overload

import numpy as np

from surrofe2.base.arrays import Array, Index
from surrofe2.base.errors import FileError, InputError, quoted
from surrofe2.law.stress_law import describe
from surrofe2.macro.elements import find_element
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.recipe.recipe import CellName, Recipe, make_recipe
from surrofe2.report.tables import check_form
from surrofe2.run.charts import encoded
from surrofe2.run.loop import Report, no_report
from surrofe2.run.views import Facts, Viewed
from surrofe2.rve import RveLaw
from surrofe2.rve.particles import Particles
from surrofe2.store.fields import (
    CELL,
    F_DOT_NAME,
    F_NAME,
    StoredFields,
    add_to_elements,
    read_fields,
    write_rve_fields,
)
from surrofe2.store.run_folder import RunRecord, cells_of, read_record
from surrofe2.store.store import locked_folder, write_bytes, write_columns
from surrofe2.workflow.laws import true_law

FIELDS_OF_MOTION = (F_DOT_NAME, F_NAME)
# RVEs whose particles are computed together: 40 MB for one plant cell each.
_AT_ONCE = 512


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Zoom(Viewed):
    """The plant cells of one element of a run at the times of its fields.

    Attributes:
        point: unloaded position, µm, that the element holds.
        element: number of the element.
        motion: fields of the run.
        seen: the RVE of the element at these times.
        is_rest: whether they are factors of the load of a rest.
        cell: name of the plant cell.
    """

    point: tuple[float, float]
    element: int
    motion: StoredFields
    seen: Particles
    is_rest: bool
    cell: CellName = None

    @property
    def t(self) -> Array:
        """Times of the path, (n,), µs; of a rest factors of the load."""
        return self.motion.t

    def extremes(self) -> dict[str, Array]:
        """Compute what bruises a tissue, (n,) each, by name with its unit; pressures in MPa."""
        return self.seen.extremes()

    def facts(self) -> Facts:
        """Return what a notebook shows of the plant cells."""
        last = {name: values[-1] for name, values in self.extremes().items()}
        lowest = last["lowest_fluid_pressure_MPa"]
        highest = last["highest_fluid_pressure_MPa"]
        facts = {
            "point": f"({self.point[0]:.6g}, {self.point[1]:.6g}) µm",
            "element": self.element,
            "load factors" if self.is_rest else "times": len(self.t),
            "wall stretch at the last": f"up to {last['largest_wall_stretch']:.4g}",
            "fluid pressure": f"{lowest:.3g} to {highest:.3g} MPa",
        }
        return facts if self.cell is None else {"plant cell": self.cell, **facts}


Point = tuple[float, float]


@overload
def zoom_into(folder: str | Path, point: Point) -> Zoom: ...
@overload
def zoom_into(folder: str | Path, point: Sequence[Point] | Array) -> list[Zoom]: ...
def zoom_into(folder: str | Path, point: Any) -> Zoom | list[Zoom]:
    """Solve the RVE of the element at a point, with its mean F and Ḟ at all frames of a run.

    Args:
        folder: of a run or a rest by any law, finished or not.
        point: unloaded position, µm; or several of them, (k, 2).

    Returns:
        What is seen there; of several points a list.

    Raises:
        FileError: not a run folder, or one without fields of elements.
        InputError: a point is no pair of numbers or outside the mesh, or an RVE has no stress at a
            frame.
    """
    try:
        points = np.array(point, dtype=np.float64)
    except (TypeError, ValueError):
        points = np.zeros(0)
    is_one = points.shape == (2,)
    if not is_one and (points.ndim != 2 or points.shape[1:] != (2,)):
        raise InputError(f"point: {quoted(point)}; it must be (x, y) in µm, or a list of them")
    folder = Path(folder)
    record = read_record(folder)
    if record.law == "tissue":
        raise InputError(f"{folder}: of the full tissue, whose fields are its particles already")
    if not (folder / "fields.h5").exists():
        raise FileError(f"{folder}: the run is {record.status} and has no fields")
    motion = read_fields(folder, FIELDS_OF_MOTION, (CELL,))
    recipes = recipes_of(record)
    numbers = cell_numbers(motion, recipes)
    laws: dict[CellName, RveLaw] = {}
    looks = []
    for x, y in points.reshape(-1, 2).tolist():
        element, _ = find_element(motion.points, motion.cells, np.array([x, y]))
        name, recipe = [*recipes.items()][numbers[element]]
        if name not in laws:
            laws[name] = true_law(recipe.study())
        law = laws[name]
        F = motion.values[F_NAME][:, element]
        F_dot = motion.values[F_DOT_NAME][:, element]
        answer = law.respond(F, F_dot)
        failed = np.flatnonzero(answer.status)
        if failed.size:
            k = failed[0]
            why = describe(answer.status[k])
            raise InputError(f"{folder}: the RVE at frame {k}, t = {motion.t[k]:.6g}: {why}")
        looks.append(
            Zoom(
                point=(x, y),
                element=element,
                motion=motion,
                seen=law.particles(F, F_dot, answer.state),
                is_rest="rest" in record.recipe,
                cell=name,
            )
        )
    return looks[0] if is_one else looks


def write_zoom(
    zoom: Zoom, out: str | Path, report: Report = no_report, *, form: str = "png"
) -> None:
    """Write a picture, zoom.csv and fields.xdmf for ParaView.

    Args:
        report: called with the share that is done and what is made.
        form: format of the picture, of `PICTURE_FORMATS`.
    """
    from surrofe2.report.figures import cell_figure  # here, since runs need no matplotlib

    out = Path(out)
    check_form(form)
    x, y = zoom.point
    cell = "" if zoom.cell is None else f" “{zoom.cell}”"
    title = f"Plant cells{cell} at ({x:.4g}, {y:.4g}) µm, element {zoom.element}"
    columns = {"factor" if zoom.is_rest else "t_us": zoom.t, **zoom.extremes()}
    with locked_folder(out):
        report(0.1, "picture")
        figure = cell_figure(
            title,
            zoom.seen,
            zoom.motion,
            zoom.element,
            zoom.point,
            zoom.is_rest,
        )
        write_bytes(out / f"zoom.{form}", encoded(figure, form))
        report(0.5, "tables and fields")
        write_columns(out / "zoom.csv", columns)
        write_rve_fields(out, zoom.seen, zoom.t)


def recipes_of(record: RunRecord) -> dict[CellName, Recipe]:
    """Return a recipe with the parameters and initialisation of each cell of a run, by name."""
    stored = record.recipe
    cells = cells_of(stored) or {None: {}}  # a run of a law without plant cells records none
    if not all("preset" in cell for cell in cells.values()):
        raise InputError(
            f"law: {record.law}; it has no plant cells to look into, as rve and cached have"
        )
    names = {item.name for item in fields(CellParameters)}
    return {
        name: make_recipe(
            {
                # cells of runs that name no fluid are from when there was but one
                "cell": {"fluid": "sph"} | {key: cell[key] for key in names & cell.keys()},
                "rve": cell.get("rve") or stored["rve"],
            }
        )
        for name, cell in cells.items()
    }


def cell_numbers(motion: StoredFields, recipes: Mapping[CellName, Recipe]) -> Index:
    """Return the number (e,) of the recipe of each element's cell."""
    if len(recipes) == 1:
        return np.zeros(len(motion.cells), np.int64)
    if CELL not in motion.values:
        raise FileError(f"fields.h5: no {CELL} of elements in it; run it again with --fresh")
    return motion.values[CELL][0].astype(np.int64)


def add_cell_fields(folder: Path) -> int:
    """Add `Particles.extremes` of every element and frame to the fields of a run.

    They are of RVEs with the mean F and Ḟ of the element, NaN where one has no stress.

    Returns:
        The number of RVEs.
    """
    recipes = recipes_of(read_record(folder))
    with locked_folder(folder):
        motion = read_fields(folder, FIELDS_OF_MOTION, (CELL,))
        F = motion.values[F_NAME]
        F_dot = motion.values[F_DOT_NAME]
        numbers = cell_numbers(motion, recipes)
        values: dict[str, Array] = {}
        for k, recipe in enumerate(recipes.values()):
            of_cell = numbers == k
            extremes = extremes_of(true_law(recipe.study()), F[:, of_cell], F_dot[:, of_cell])
            for name, column in extremes.items():
                whole = values.setdefault(name, np.full(F.shape[:2], np.nan))
                whole[:, of_cell] = column
        add_to_elements(folder, values)
    return F.size // 4


def extremes_of(law: RveLaw, F_of: Array, F_dot_of: Array) -> dict[str, Array]:
    """Compute `Particles.extremes` at F, Ḟ (m, e, 2, 2), by name: (m, e), NaN without a stress."""
    F = F_of.reshape(-1, 2, 2)
    F_dot = F_dot_of.reshape(-1, 2, 2)
    extremes: dict[str, Array] = {}
    for begin in range(0, len(F), _AT_ONCE):
        part = slice(begin, begin + _AT_ONCE)
        answer = law.respond(F[part], F_dot[part])
        solved = np.flatnonzero(answer.status == 0)
        if not solved.size:
            continue
        state = answer.state.take(solved)
        seen = law.particles(F[part][solved], F_dot[part][solved], state)
        for name, values in seen.extremes().items():
            whole = extremes.setdefault(name, np.full(len(F), np.nan))
            whole[begin + solved] = values
    return {name: values.reshape(F_of.shape[:2]) for name, values in extremes.items()}

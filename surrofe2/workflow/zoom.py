"""A look into the plant cells of a run: one point over time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import FileError, InputError
from surrofe2.law.stress_law import describe
from surrofe2.macro.discretisation import find_element
from surrofe2.report.figures import cell_figure
from surrofe2.run.charts import encoded
from surrofe2.rve import RveLaw
from surrofe2.rve.particles import Particles
from surrofe2.store.fields import F_DOT_NAME, F_NAME, StoredFields, write_rve_fields
from surrofe2.store.run_folder import RunRecord, read_record
from surrofe2.store.store import locked_folder, write_bytes, write_columns
from surrofe2.workflow.cell_fields import cell_numbers, read_motion, recipes_of
from surrofe2.workflow.laws import true_law
from surrofe2.workflow.progress import Report, no_report

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Zoom:
    """The RVE of one element over time.

    Attributes:
        point: that was asked for, unloaded, µm.
        element: number of its element. motion: the fields of the run.
        seen: the particles at these times.
        is_rest: whether the run is a rest.
        cell: name of its plant cell, of several.
    """

    point: tuple[float, float]
    element: int
    motion: StoredFields
    seen: Particles
    is_rest: bool
    cell: str = ""

    @property
    def t(self) -> Array:
        """(n,) µs, of a rest the factor of the load."""
        return self.motion.t


def zoom_into(folder: str | Path, point: tuple[float, float]) -> Zoom:
    """The true RVE of the element at a point, with its mean F and Ḟ at all frames of a run.

    Args:
        folder: of a run or a rest by any law, finished or not.
        point: unloaded position, µm.

    Raises:
        FileError: not a run folder, or one without fields of elements.
        InputError: the point is outside the mesh, or the RVE has no stress at a frame.
    """
    folder = Path(folder)
    if not (folder / "run.json").exists():
        raise FileError(f"{folder}: no run.json; it is not a run folder")
    record = read_record(folder)
    if record.law == "tissue":
        raise InputError(f"{folder}: of the full tissue, whose fields are its particles already")
    if not (folder / "fields.h5").exists():
        raise FileError(f"{folder}: the run is {record.status} and has no fields")
    motion = read_motion(folder)
    element, _ = find_element(motion.points, motion.cells, np.array(point))
    name, law = _law_at(record, motion, element)
    F, F_dot = (motion.values[what][:, element] for what in (F_NAME, F_DOT_NAME))
    answer = law.respond(F, F_dot)
    for k in np.flatnonzero(answer.status)[:1]:
        why = describe(answer.status[k])
        raise InputError(f"{folder}: the RVE at frame {k}, t = {motion.t[k]:.6g}: {why}")
    seen = law.particles(F, F_dot, answer.state)
    return Zoom(point, element, motion, seen, "rest" in record.recipe, name)


def _law_at(record: RunRecord, motion: StoredFields, element: int) -> tuple[str, RveLaw]:
    """Name and true RVE of the plant cell of an element."""
    recipes = recipes_of(record)
    numbers = cell_numbers(motion, recipes)
    name, recipe = [*recipes.items()][numbers[element]]
    return name, true_law(recipe)


def write_zoom(found: Zoom, out: str | Path, report: Report = no_report) -> None:
    """Write zoom.png, zoom.csv and fields.xdmf for ParaView.

    Args:
        report: called with the share that is done and what is made.
    """
    out = Path(out)
    clock = "load factor {:.4g}" if found.is_rest else "t = {:.4g} µs"
    x, y = found.point
    of = found.cell and f" “{found.cell}”"
    title = f"Plant cells{of} at ({x:.4g}, {y:.4g}) µm, element {found.element}"
    columns = {"factor" if found.is_rest else "t_us": found.t, **found.seen.extremes()}
    with locked_folder(out):
        report(0.1, "picture")
        figure = cell_figure(title, found.seen, found.motion, found.element, found.point, clock)
        write_bytes(out / "zoom.png", encoded(figure, "png"))
        report(0.5, "tables and fields")
        write_columns(out / "zoom.csv", columns)
        write_rve_fields(out, found.seen, found.t)

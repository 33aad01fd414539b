"""The problem of a recipe as one of the full tissue, or the sentence why it is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import skfem
from numpy.typing import NDArray

from surrofe2.cell_types import REST
from surrofe2.errors import InputError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.problem import conditions as stated_as
from surrofe2.problem.conditions import (
    BodyForce,
    Condition,
    Fixed,
    InitialVelocity,
    PrescribedMotion,
    Symmetry,
    Traction,
)
from surrofe2.problem.mesh import nodes_on
from surrofe2.problem.problem import label
from surrofe2.recipe import Recipe
from surrofe2.tissue.problem import (
    Foundation,
    Load,
    Pressure,
    Support,
    TissueProblem,
    as_problem,
    middles_of,
    outline,
)
from surrofe2.tissue.simulation import cells_that_fill

_LOADS = (BodyForce, Traction, stated_as.Pressure, stated_as.Foundation)
_SUPPORTS = (Fixed, Symmetry, PrescribedMotion)


def cells_of(recipe: Recipe) -> list[CellParameters]:
    """The plant cells of a recipe in their order."""
    return [part.cell for part in recipe.parts().values()]


def problem_of_tissue(recipe: Recipe) -> TissueProblem:
    """What a recipe states, for the full tissue: the bar of [load], or a rectangle with conditions.

    Raises:
        InputError: naming what a tissue of particles does not take.
    """
    if recipe.stated is None:
        cells_that_fill(recipe.bar_load(), recipe.cell)
        return as_problem(recipe.bar_load())
    stated, problem = recipe.stated, recipe.problem()
    try:
        width, height = stated.mesh.width, stated.mesh.height
        if width is None or height is None:
            raise InputError(
                f"mesh.file: {stated.mesh.file!r}; a full tissue needs a rectangle: mesh.width and "
                "mesh.height"
            )
        boundaries = {**outline(width, height), **stated.boundaries}
        problem.check_course()
        found = TissueProblem(
            width=width,
            height=height,
            boundaries=boundaries,
            regions=stated.regions,
            supports=tuple(
                _support(each, problem.mesh)
                for each in stated.conditions
                if isinstance(each, _SUPPORTS)
            ),
            loads=tuple(_load(each) for each in stated.conditions if isinstance(each, _LOADS)),
            bodies=stated.bodies,
            velocities=tuple(
                (each.on, each.velocity)
                for each in stated.conditions
                if isinstance(each, InitialVelocity)
            ),
            duration=problem.duration,
            output_interval=problem.output_interval,
            watched=problem.watched,
        )
        counts = cells_that_fill(found, recipe.cell, "mesh")
        return replace(found, kind=_kinds(recipe, counts) if recipe.types else None)
    except InputError as error:
        raise InputError(f"{recipe.path.name}: {error}") from None


def _support(condition: Condition, mesh: skfem.Mesh) -> Support:
    name, on = label(condition), str(condition.on)
    match condition:
        case Fixed():
            both = "x" in condition.components, "y" in condition.components
            return Support(name=name, on=on, components=both)
        case PrescribedMotion():
            x, y = condition.displacement
            return Support(
                name=name,
                on=on,
                components=(x is not None, y is not None),
                displacement=(x or 0.0, y or 0.0),
                amplitude=condition.amplitude,
            )
    extent = np.ptp(mesh.p.T[nodes_on(mesh, on)], axis=0)
    if extent.min() > 1e-9 * extent.max():
        raise InputError(f"symmetry.on: {on}; it must be straight along x or along y")
    across = bool(extent[0] < extent[1])
    return Support(name=name, on=on, components=(across, not across))


def _load(condition: Condition) -> Load | Pressure | Foundation:
    name = label(condition)
    match condition:
        case BodyForce(on=on, acceleration=g, amplitude=amplitude):
            return Load(name=name, on=on, acceleration=g, amplitude=amplitude)
        case Traction(on=on, traction=t, amplitude=amplitude):
            return Load(name=name, on=on, traction=t, amplitude=amplitude)
        case stated_as.Pressure(on=on, pressure=p, amplitude=amplitude):
            return Pressure(name=name, on=on, pressure=p, amplitude=amplitude)
        case stated_as.Foundation(on=on, stiffness=k, damping=c, components=both):
            held = "x" in both, "y" in both
            return Foundation(name=name, on=on, stiffness=k, damping=c, components=held)
    raise AssertionError(condition)


def _kinds(recipe: Recipe, counts: tuple[int, int]) -> NDArray[np.int64]:
    """(n, m) which of the recipe's cells each plant cell is, by where its middle lies."""
    assert recipe.stated is not None
    parts = recipe.stated.regions
    middles = middles_of(counts, recipe.cell.cell_side)
    kind = np.full(len(middles), -1)
    for k, (name, each) in enumerate(recipe.types.items()):
        for region in each.regions:
            if region not in parts:
                continue
            inside = parts[region].holds(middles)
            twice = np.flatnonzero(inside & (kind >= 0) & (kind != k))
            if twice.size:
                x, y = middles[twice[0]]
                raise InputError(
                    f"cells.{name}.regions: {region}; the plant cell at ({x:g}, {y:g}) µm is of "
                    "another type, too"
                )
            kind[inside] = k
    rest = [k for k, each in enumerate(recipe.types.values()) if REST in each.regions]
    if rest and REST not in parts:
        kind[kind < 0] = rest[0]
    if (kind < 0).any():
        x, y = middles[np.flatnonzero(kind < 0)[0]]
        raise InputError(f"cells: none fills the plant cell at ({x:g}, {y:g}) µm; give it a type")
    return kind.reshape(counts)

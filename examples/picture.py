"""Draws the picture of an example: a recipe from Python, `python examples/picture.py NAME …`."""

import sys
from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from surrofe2 import simulate
from surrofe2.recipe.recipe import load_recipe
from surrofe2.workflow.laws import law_by_region, true_law

FOLDER = Path(__file__).parent
CURVES = {  # name: (over, force or displacement of a watched point, sign that makes it positive)
    "block-between-plates": ("mean displacement top y", "force upper y", -1.0),
    "drop-on-plate": ("time", "force plate y", 1.0),
    "tensile-strip": ("time", "force clamp x", -1.0),
    "notched-leaf": ("time", "force clamp x", -1.0),
    "hexagons-in-tension": ("time", "force grip x", 1.0),
    "voronoi-in-tension": ("time", "force grip x", 1.0),
    "skin-over-parenchyma": ("time", "displacement tip y", -1.0),
}


def column(run, name):
    """A column of history.csv, or a component of a watched point's displacement."""
    if name in run.history:
        return run.history[name]
    point, axis = name.removeprefix("displacement ").rsplit(" ", 1)
    return run.curves[point].displacement[:, "xy".index(axis)]


def draw(name, run, path):
    """A curve over time or displacement; the deformed mesh when it is highest."""
    over, which, sign = CURVES[name]
    value = sign * column(run, which)
    x = run.curve.t if over == "time" else column(run, over)
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(x, value, color="#0072B2")
    left.set_xlabel("time (µs)" if over == "time" else f"{over} (µm)")
    unit = "µN" if which.startswith("force") else "µm"
    left.set_ylabel(f"{'−' if sign < 0.0 else ''}{which} ({unit})")
    peak = run.curve.t[value.argmax()]
    k = abs(run.frames.t - peak).argmin()
    largest = np.linalg.eigvalsh(run.frames.stress[k])
    shown = np.take_along_axis(largest, abs(largest).argmax(axis=1)[:, None], axis=1)[:, 0]
    draw_tissue(right, run, k, shown, "principal stress of\nlargest size (µN/µm)")
    figure.savefig(path, dpi=100)


def draw_tissue(place, run, k, shown, label):
    """The deformed mesh at frame k, coloured by the values of its elements."""
    corners = run.elements[:, : 3 if run.elements.shape[1] == 6 else 4]
    places = (run.nodes + run.frames.displacement[k])[corners]
    tissue = PolyCollection(places, array=shown, cmap="viridis", edgecolor="black", linewidth=0.4)
    place.add_collection(tissue)
    place.autoscale()
    place.set_aspect("equal")
    place.set_xlabel(f"x (µm), at {run.frames.t[k]:.3g} µs")
    place.figure.colorbar(tissue, ax=place, label=label)


def draw_cells(run, law, path):
    """The largest wall stretch: over the tissue when it is largest, over time, wall by wall."""
    F, F_dot = run.frames.F, run.frames.F_dot
    seen = law.particles(F.reshape(-1, 2, 2), F_dot.reshape(-1, 2, 2))
    stretch = seen.extremes()["largest_wall_stretch"].reshape(F.shape[:2])
    k, element = np.unravel_index(stretch.argmax(), stretch.shape)
    plate = int(run.nodes[run.elements].mean(axis=1).sum(axis=1).argmin())
    figure = Figure(figsize=(11.0, 3.4), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    draw_tissue(left, run, k, stretch[k], "largest wall stretch")
    for which, label in ((element, "where it is largest"), (plate, "at the plate")):
        middle.plot(run.frames.t, stretch[:, which], label=label)
    middle.set_xlabel("time (µs)")
    middle.set_ylabel("largest wall stretch")
    middle.legend(loc="upper left", fontsize="small")
    rve = k * len(run.elements) + element
    lattice, x = seen.F[rve] @ seen.lattice, seen.position[rve]
    first, second = x[seen.bonds[:, 0]], x[seen.bonds[:, 1]] + seen.bond_shift @ lattice.T
    walls = LineCollection(
        [*np.stack([first, second], axis=1)], array=seen.stretch[rve], linewidths=4.0
    )
    right.add_collection(walls)
    fluid = x[~seen.is_wall]
    right.plot(*fluid.T, "o", color="#56B4E9", markersize=4.0)
    right.autoscale()
    right.set_aspect("equal")
    right.set_xlabel(f"x (µm) in the cell there, at {run.frames.t[k]:.3g} µs")
    figure.colorbar(walls, ax=right, label="wall stretch")
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    for name in sys.argv[1:] or CURVES:
        recipe = load_recipe(FOLDER / f"{name}.toml")
        problem = recipe.problem()
        law = law_by_region(recipe, problem.mesh, true_law)
        run = simulate(problem, law, recipe.macro)
        draw(name, run, FOLDER / f"{name}.png")
        if name == "drop-on-plate":
            draw_cells(run, law, FOLDER / f"{name}-cells.png")

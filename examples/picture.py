"""Draws the picture of an example: a recipe from Python, `python examples/picture.py NAME …`.

A curve, the whole specimen when the curve is highest, and the plant cells where the stress is.
Where the stress is the same all over the specimen, it is coloured by its displacement.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import ConnectionPatch

from surrofe2 import (
    Colours,
    RegionalLaw,
    draw_cells,
    draw_tissue,
    drawn_bodies,
    drawn_loads,
    load_recipe,
    simulate,
)
from surrofe2.report.figures import box, draw_borders
from surrofe2.run.charts import BLUE, VERMILION, encoded
from surrofe2.store.fields import DISPLACEMENT_NAME, StoredFields
from surrofe2.workflow.laws import law_by_region, true_law

FOLDER = Path(__file__).parent
TIME = "time", 1.0, "time (µs)"
# Stresses that differ by less than this fraction of the largest are one colour.
UNIFORM = 0.05
CURVES = {  # name: over and of what: (column, sign that makes it positive, words)
    "block-between-plates": (
        ("mean displacement top y", -1.0, "shortening of the block (µm)"),
        ("force upper y", -1.0, "force of the plate on half the block (µN)"),
    ),
    "drop-on-plate": (TIME, ("force plate y", 1.0, "force of the plate on half the drop (µN)")),
    "tensile-strip": (TIME, ("force clamp x", -1.0, "force at the clamp, half the strip (µN)")),
    "notched-leaf": (TIME, ("force clamp x", -1.0, "force at the clamp (µN)")),
    "hexagons-in-tension": (TIME, ("force grip x", 1.0, "force at the grip, half the strip (µN)")),
    "voronoi-in-tension": (TIME, ("force grip x", 1.0, "force at the grip, half the strip (µN)")),
    "skin-over-parenchyma": (TIME, ("displacement tip y", -1.0, "deflection of the tip (µm)")),
}


def column(run, name):
    """The time, a column of history.csv, or a component of a watched point's displacement."""
    if name == "time":
        return run.curve.t
    if name in run.history:
        return run.history[name]
    point, axis = name.removeprefix("displacement ").rsplit(" ", 1)
    return run.curves[point].displacement[:, "xy".index(axis)]


def law_at(law, element, elements):
    """The RVEs of an element, in tissue of several plant cells, too."""
    if not isinstance(law, RegionalLaw):
        return law
    per_element = law.density.size // elements
    return next(
        law.laws[name] for name, at in law.points.items() if (at // per_element == element).any()
    )


def stresses(frames, k, thickness):
    """The principal stress of largest size of each element at frame k, MPa."""
    principal = np.linalg.eigvalsh(frames.stress[k])
    largest = abs(principal).argmax(axis=1)[:, None]
    return np.take_along_axis(principal, largest, axis=1)[:, 0] / thickness


def coloured(stress, displacement, elements):
    """Values by which the specimen is coloured, their colours, and words where it has one stress.

    Args:
        stress: (e,) MPa.
        displacement: (n, 2) of the nodes, µm.
    """
    if np.ptp(stress) > UNIFORM * abs(stress).max():
        return stress, Colours.of("principal stress of largest size (MPa)", stress), ""
    axis = int(np.ptp(displacement, axis=0).argmax())
    moved = displacement[elements].mean(axis=1)[:, axis]
    colours = Colours.of(f"displacement $u_{'xy'[axis]}$ (µm)", moved)
    words = f"{stress.mean():.3g}".replace("-", "−")
    return moved, colours, f"\nstress everywhere {words} MPa"


def draw(name, run, law, problem, path):
    """The picture of an example from its run."""
    over, what = CURVES[name]
    x, value = (sign * column(run, which) for which, sign, _ in (over, what))
    frames = run.frames
    fields = StoredFields(
        run.nodes, run.elements, frames.t, {DISPLACEMENT_NAME: frames.displacement}
    )
    peak = run.curve.t[value.argmax()]
    k = int(abs(frames.t - peak).argmin())
    rves = list(law.laws.values()) if isinstance(law, RegionalLaw) else [law]
    stress = stresses(frames, k, rves[0].cell.tissue_thickness)
    element = int(abs(stress).argmax())

    low, high = box(fields.points, ())
    wide = 1.5 if (high - low)[0] > 2.5 * (high - low)[1] else 1.0
    figure = Figure(figsize=(9.0 + 2.0 * wide, 3.8), layout="constrained")
    curve, place, cells = figure.subplots(1, 3, width_ratios=(1.2, wide, 1.2))

    curve.plot(x, value, color=BLUE)
    at = int(value.argmax())
    curve.plot(x[at], value[at], "o", color=VERMILION)
    curve.set(xlabel=over[2], ylabel=what[2])
    curve.grid(alpha=0.25)

    values, colours, words = coloured(stress, frames.displacement[k], run.elements)
    shown = drawn_bodies(problem.bodies, run.curve.t, run.history, fields)
    loads = drawn_loads(problem, fields)
    drawn = draw_tissue(place, fields, k, values, colours, bodies=shown, nodes=loads)
    if isinstance(law, RegionalLaw):
        draw_borders(place, fields, k, list(problem.mesh.subdomains.values()))
    place.set_title(f"at the dot, {frames.t[k]:.4g} µs{words}", fontsize=9)
    colours.bar(place, drawn, "bottom")

    rve = law_at(law, element, len(run.elements))
    seen = rve.particles(frames.F[k, element][None], frames.F_dot[k, element][None])
    span = float(np.linalg.norm(seen.lattice, axis=0).max())
    cell = np.sqrt(abs(np.linalg.det(seen.lattice)) / (seen.fluid_cell.max() + 1))
    (walls, lines), (fluid, dots) = draw_cells(cells, seen, 0, max(0.75 * span, 1.6 * cell))
    walls.bar(cells, lines, "bottom")
    fluid.bar(cells, dots)
    cells.set_title("plant cells there", fontsize=9)
    corners = (fields.points + fields.displacement[k])[run.elements[element]]
    middle = corners.mean(axis=0)
    place.plot(*middle, "s", color=VERMILION, markersize=6.0, fillstyle="none", mew=1.5)
    figure.add_artist(
        ConnectionPatch(
            middle, (0.0, 0.6), coordsA="data", coordsB="axes fraction", axesA=place, axesB=cells,
            color=VERMILION, linewidth=1.0,
        )
    )  # fmt: skip
    path.write_bytes(encoded(figure, path.suffix.removeprefix(".")))


if __name__ == "__main__":
    for name in sys.argv[1:] or CURVES:
        recipe = load_recipe(FOLDER / f"{name}.toml")
        problem = recipe.problem()
        law = law_by_region(recipe, problem.mesh, true_law)
        # a frame at each output, so that there is one when the curve is highest
        outputs = len(problem.output_times())
        run = simulate(problem, law, replace(recipe.macro, frames=outputs))
        draw(name, run, law, problem, FOLDER / f"{name}.png")
        print(name)

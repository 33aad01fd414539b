"""A disc is pressed into apple flesh under a stiff skin, at rest: force over depth, and the cells.

`python docs/gallery/puncture.py` prints the page's figures and draws puncture.png.
"""

from pathlib import Path

import numpy as np
import skfem
from matplotlib.figure import Figure

from surrofe2 import (
    Box,
    Circle,
    Colours,
    Fixed,
    Problem,
    RegionalLaw,
    RigidBody,
    RveLaw,
    SimulationError,
    Symmetry,
    draw_cells,
    draw_tissue,
    drawn_bodies,
    fields_at_rest,
    find_rest,
    living_cell,
    points_by_region,
    with_regions,
)
from surrofe2.run.charts import BLUE, ORANGE, VERMILION, encoded
from surrofe2.run.journal import BEYOND

RADIUS = 2000.0  # µm, of the disc
DEPTH = 700.0  # µm
HALF_WIDTH = 6000.0  # µm, to the right of the line of symmetry
HEIGHT = 5000.0  # µm, with the skin
SKIN = 300.0  # µm: two cells
THICKNESS = 10.0  # µm, of the layer that is computed
STRETCH = Colours("wall length / rest length", 1.0, 1.1, "viridis")
PRESSURE = Colours("pressure of the sap (MPa)", 0.3, 0.6, "Blues")


def laws():
    """Laws of the two kinds of cell: a skin of walls along and across it, and hexagons below."""
    skin = living_cell("apple", arrangement="square", wall_modulus=600.0)
    flesh = living_cell("apple", arrangement="hexagon")
    return {"skin": RveLaw(skin), "flesh": RveLaw(flesh)}


def half_mesh(beside=(12, 6), below=8):
    """Mesh of the right half, finer at the disc: elements below it and beside it, and downwards."""
    near = np.linspace(0.0, 1.2 * RADIUS, beside[0] + 1)
    far = 1.2 * RADIUS + (HALF_WIDTH - 1.2 * RADIUS) * np.linspace(0.0, 1.0, beside[1] + 1) ** 1.5
    depths = (HEIGHT - SKIN) * np.linspace(0.0, 1.0, below + 1) ** 1.5
    x = np.concatenate([near, far[1:]])
    y = np.concatenate([HEIGHT - SKIN - depths[::-1], [HEIGHT]])
    mesh = skfem.MeshQuad1.init_tensor(x, y).with_defaults()
    skin = Box((0.0, HEIGHT - SKIN), (HALF_WIDTH, HEIGHT))
    flesh = Box((0.0, 0.0), (HALF_WIDTH, HEIGHT - SKIN))
    return with_regions(mesh, skin=skin, flesh=flesh)


def pressed(law_of, mesh, depth=DEPTH, steps=28):
    """Rest of the tissue when the disc is `depth` deep, or the last one before, and what ended it.

    Args:
        law_of: laws by name of the region.
    """
    disc = RigidBody(
        name="disc",
        shape=Circle(radius=RADIUS),
        on="top",
        position=(0.0, HEIGHT + RADIUS),
        displacement=(0.0, -depth),
    )
    problem = Problem(
        mesh=mesh,
        conditions=(Symmetry(on="left"), Fixed(on="bottom")),
        bodies=(disc,),
        watched={"below the disc": (0.0, HEIGHT)},
    )
    tissue = RegionalLaw(law_of, points_by_region(mesh, tuple(law_of)))
    try:
        return find_rest(problem, tissue, load_steps=steps), "its load"
    except SimulationError as error:
        return error.partial, str(error)


def force_over_depth(rest):
    """Depth of the disc, µm, and the force on the whole of it, µN."""
    columns = rest.columns
    return -columns["position disc y"], -2.0 * columns["force disc y"]


def draw_specimen(axes, rest):
    """Draw the whole specimen under the disc, by the stress along the disc's way."""
    fields = fields_at_rest(rest)
    columns = rest.columns
    bodies = drawn_bodies(rest.system.problem.bodies, columns["t"], columns, fields)
    pressure = -rest.element_stress[:, 1, 1] / THICKNESS
    colours = Colours.of("vertical pressure (MPa)", pressure, "viridis")
    colours.bar(axes, draw_tissue(axes, fields, 1, pressure, colours, bodies=bodies), "bottom")


def cells_below(rest, law_of):
    """Cells of the skin and of the flesh beside the line of symmetry, uppermost first."""
    F = rest.element_F
    middle = rest.system.discretisation.nodes[rest.system.discretisation.elements].mean(axis=1)
    column = np.flatnonzero(np.isclose(middle[:, 0], middle[:, 0].min()))
    skin, flesh = column[np.argsort(-middle[column, 1])[:2]]
    still = np.zeros((1, 2, 2))
    return [
        law_of["skin"].particles(F[skin][None], still),
        law_of["flesh"].particles(F[flesh][None], still),
    ]


if __name__ == "__main__":
    by_region = laws()
    mesh = half_mesh()
    figure = Figure(figsize=(12.0, 4.6), layout="constrained")
    rows = [["curve", "specimen", "skin"], ["curve", "specimen", "flesh"]]
    places = figure.subplot_mosaic(rows, width_ratios=(1.0, 1.6, 0.6))
    curve = places["curve"]
    flesh_alone = dict.fromkeys(by_region, by_region["flesh"])
    names = {"under a stiff skin": by_region, "flesh alone": flesh_alone}
    for (name, law_of), colour in zip(names.items(), (BLUE, ORANGE), strict=True):
        rest, ending = pressed(law_of, mesh)
        depth, force = force_over_depth(rest)
        print(f"{name}: {force[-1]:.0f} µN at {depth[-1]:.0f} µm; ended by {ending}")
        first = np.flatnonzero(rest.columns[BEYOND] > 0)[:1]
        print(f"  first buckling at {depth[first]} µm, points {rest.columns[BEYOND][-1]}")
        curve.plot(depth, force, color=colour, label=name)
        if first.size:
            curve.plot(depth[first], force[first], "o", color=VERMILION, label="first buckling")
        if law_of is by_region:
            draw_specimen(places["specimen"], rest)
            seen = cells_below(rest, by_region)
    curve.set(xlabel="depth of the disc (µm)", ylabel="force on the disc (µN)", ylim=(0.0, None))
    curve.legend(fontsize=8)
    curve.grid(alpha=0.25)
    cells_at = [places["skin"], places["flesh"]]
    for axes, cells, name in zip(cells_at, seen, ("skin", "flesh"), strict=True):
        (_, lines), (_, areas) = draw_cells(axes, cells, 0, half=230.0)
        STRETCH.paint(lines, lines.get_array())
        PRESSURE.paint(areas, areas.get_array())
        axes.set_title(f"cells of the {name}", fontsize=9)
        print(f"  {name}: walls stretched {cells.stretch.min():.3f} to {cells.stretch.max():.3f}")
        print(f"  pressure {cells.pressure.max():.3f} MPa")
    STRETCH.bar(cells_at, lines)
    PRESSURE.bar(cells_at, areas)
    Path(__file__).with_suffix(".png").write_bytes(encoded(figure, "png"))

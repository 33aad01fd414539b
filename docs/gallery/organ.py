"""A ribbed stem of cortex and pith, meshed by Gmsh, is squeezed between two plates at rest.

It needs Gmsh, which is in the extra "dev": pip install gmsh.
`python docs/gallery/organ.py` prints the page's figures and draws organ.png.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import gmsh
import numpy as np
from matplotlib.figure import Figure

from surrofe2 import (
    Colours,
    Plane,
    Problem,
    RegionalLaw,
    RigidBody,
    RveLaw,
    Symmetry,
    draw_tissue,
    drawn_bodies,
    fields_at_rest,
    find_rest,
    living_cell,
    load_mesh,
    points_by_region,
)
from surrofe2.report.figures import DrawnBody
from surrofe2.run.charts import PALETTE, encoded

RADIUS = 3.0  # mm, of the stem on average
RIB = 0.03  # height of its ribs over the radius
RIBS = 8
PITH = 2.0  # mm, radius of the pith
SQUEEZE = 300.0  # µm, by which each plate moves
TURGORS = (0.4, 0.2, 0.1)  # MPa, of the pith
QUARTER = 0.5 * np.pi


def outline(angles):
    """Points (n, 2) of the stem's outline, mm."""
    radius = RADIUS * (1.0 + RIB * np.cos(RIBS * angles))
    return np.stack([radius * np.cos(angles), radius * np.sin(angles)], axis=1)


def write_mesh(path, size=0.25):
    """Write a mesh of six-node triangles, some `size` mm wide, of a quarter of the stem."""
    gmsh.initialize()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        geo = gmsh.model.geo
        centre = geo.addPoint(0.0, 0.0, 0.0)
        right = geo.addPoint(PITH, 0.0, 0.0)
        upper = geo.addPoint(0.0, PITH, 0.0)
        rim = [geo.addPoint(x, y, 0.0) for x, y in outline(np.linspace(0.0, QUARTER, 17))]
        between = geo.addCircleArc(right, centre, upper)
        outside = geo.addSpline(rim)
        pith_below = geo.addLine(centre, right)
        pith_left = geo.addLine(upper, centre)
        cortex_below = geo.addLine(right, rim[0])
        cortex_left = geo.addLine(rim[-1], upper)
        pith = geo.addCurveLoop([pith_below, between, pith_left])
        cortex = geo.addCurveLoop([cortex_below, outside, cortex_left, -between])
        surfaces = [geo.addPlaneSurface([pith]), geo.addPlaneSurface([cortex])]
        geo.synchronize()
        # names of regions and boundaries
        gmsh.model.addPhysicalGroup(2, surfaces[:1], name="pith")
        gmsh.model.addPhysicalGroup(2, surfaces[1:], name="cortex")
        gmsh.model.addPhysicalGroup(1, [pith_below, cortex_below], name="below")
        gmsh.model.addPhysicalGroup(1, [pith_left, cortex_left], name="left")
        gmsh.model.addPhysicalGroup(1, [outside], name="outline")
        gmsh.model.mesh.generate(2)
        gmsh.model.mesh.setOrder(2)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()


def stem_mesh(size=0.25):
    """Mesh of a quarter of the stem, in µm."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "stem.msh"
        write_mesh(path, size)
        return load_mesh(path, "mm")


def squeezed(mesh, pith_turgor, steps=10):
    """Quarter of the stem at rest when both plates have moved by `SQUEEZE`."""
    top = float(mesh.p[1].max())
    plate = RigidBody(
        name="plate",
        shape=Plane(normal=(0.0, -1.0)),
        on="outline",
        position=(0.0, top),
        displacement=(0.0, -SQUEEZE),
    )
    problem = Problem(
        mesh=mesh,
        conditions=(Symmetry(on="left"), Symmetry(on="below")),
        bodies=(plate,),
        watched={"top": (0.0, top)},
    )
    # small cells with thick walls around large ones with thin walls
    cortex = living_cell(
        "potato", turgor=0.8, cell_size=75.0, wall_thickness=2.0, arrangement="hexagon"
    )
    pith = living_cell("apple", turgor=pith_turgor, arrangement="hexagon")
    laws = {"cortex": RveLaw(cortex), "pith": RveLaw(pith)}
    tissue = RegionalLaw(laws, points_by_region(mesh, tuple(laws)))
    return find_rest(problem, tissue, load_steps=steps)


def force_over_squeeze(rest):
    """Movement of both plates together, µm, and the force on the whole stem, µN."""
    columns = rest.columns
    return 2.0 * SQUEEZE * columns["t"], -2.0 * columns["force plate y"]


def pressures(rest):
    """Pressure −(σ₁ + σ₂)/2 of each element, MPa, of a layer of 10 µm."""
    return -0.5 * np.trace(rest.element_stress, axis1=1, axis2=2) / 10.0


def draw_specimen(axes, rest, colours):
    """Draw the whole stem between its two plates, and the rim of its pith."""
    fields = fields_at_rest(rest)
    bodies = rest.system.problem.bodies
    (upper,) = drawn_bodies(bodies, rest.columns["t"], rest.columns, fields)
    mirror = np.array([1.0, -1.0])
    outline_below = mirror * upper.outline
    # thin, so that the scale bar stands below it
    outline_below[:, 1] = np.maximum(outline_below[:, 1], outline_below[:, 1].max() - 450.0)
    lower = DrawnBody(outline_below, mirror * upper.moved)
    drawn = draw_tissue(axes, fields, 1, pressures(rest), colours, bodies=[upper, lower])
    on_rim = np.isclose(np.hypot(*fields.points.T), 1000.0 * PITH, rtol=1e-3)
    rim = (fields.points + fields.displacement[1])[on_rim]
    rim = rim[np.argsort(rim[:, 0])]
    for side in (mirror, -mirror, mirror**2, -(mirror**2)):
        axes.plot(*(side * rim).T, color="black", linewidth=1.5)
    axes.text(700.0, 500.0, "pith", color="black")
    axes.text(1150.0, 1750.0, "cortex", color="black")
    return drawn


if __name__ == "__main__":
    mesh = stem_mesh()
    print(mesh.nelements, "triangles")
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    specimen, curve = figure.subplots(1, 2, width_ratios=(1.2, 1.0))
    for turgor, colour in zip(TURGORS, PALETTE, strict=False):
        rest = squeezed(mesh, turgor)
        x, force = force_over_squeeze(rest)
        print(f"turgor of the pith {turgor} MPa: {force[-1]:.0f} µN at {x[-1]:.0f} µm")
        curve.plot(x, force, color=colour, label=f"{turgor:g} MPa")
        if turgor == TURGORS[0]:
            highest = pressures(rest).max()
            print(f"highest pressure of an element {highest:.2f} MPa")
            colours = Colours("pressure (MPa; higher at the plates)", -0.2, 0.2, "RdBu_r")
            colours.bar(specimen, draw_specimen(specimen, rest, colours))
    curve.set(xlabel="squeeze (µm)", ylabel="force on the stem (µN)", ylim=(0.0, None))
    curve.legend(title="turgor of the pith", fontsize=8)
    curve.grid(alpha=0.25)
    Path(__file__).with_suffix(".png").write_bytes(encoded(figure, "png"))

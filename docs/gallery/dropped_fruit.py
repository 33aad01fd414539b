"""A round fruit with a skin, meshed by Gmsh, is dropped on a plate.

It needs Gmsh, which is in the extra "dev": pip install gmsh.
`python docs/gallery/dropped_fruit.py` prints the page's figures and draws dropped_fruit.png.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import gmsh
import numpy as np
from matplotlib.figure import Figure

from surrofe2 import (
    Colours,
    InitialVelocity,
    MacroSettings,
    Plane,
    Problem,
    RegionalLaw,
    RigidBody,
    RveLaw,
    Symmetry,
    draw_tissue,
    drawn_bodies,
    living_cell,
    load_mesh,
    points_by_region,
    simulate,
)
from surrofe2.run.charts import PALETTE, encoded
from surrofe2.store.fields import DISPLACEMENT_NAME, StoredFields
from surrofe2.workflow.zoom import extremes_of

RADIUS = 5.0  # mm
SKIN = 0.5  # mm
SPEED = 0.5  # m/s, after a fall of 13 mm
TURGORS = (0.4, 0.2, 0.1)  # MPa
WATER = 2200.0  # MPa, bulk modulus of sap that cannot leave its cell during an impact
THICKNESS = 10.0  # µm, of the layer that is computed


def write_mesh(path, size):
    """Write a mesh of six-node triangles, some `size` mm wide, of the right half of the fruit."""
    gmsh.initialize()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        occ = gmsh.model.occ
        fruit = occ.addDisk(0.0, 0.0, 0.0, RADIUS, RADIUS)
        inside = occ.addDisk(0.0, 0.0, 0.0, RADIUS - SKIN, RADIUS - SKIN)
        right = occ.addRectangle(0.0, -RADIUS, 0.0, RADIUS, 2.0 * RADIUS)
        halves, _ = occ.intersect([(2, fruit), (2, inside)], [(2, right)])
        parts, _ = occ.fragment(halves[:1], halves[1:])  # glued where they touch
        occ.synchronize()
        skin, flesh = sorted((tag for _, tag in parts), key=lambda tag: occ.getMass(2, tag))
        outline = gmsh.model.getBoundary(parts, combined=True, oriented=False)
        curves = {"axis": [], "rim": []}
        for _, tag in outline:
            x, _, _ = occ.getCenterOfMass(1, tag)
            curves["axis" if abs(x) < 1e-6 else "rim"].append(tag)
        # names of regions and boundaries
        gmsh.model.addPhysicalGroup(2, [skin], name="skin")
        gmsh.model.addPhysicalGroup(2, [flesh], name="flesh")
        for name, tags in curves.items():
            gmsh.model.addPhysicalGroup(1, tags, name=name)
        gmsh.model.mesh.generate(2)
        gmsh.model.mesh.setOrder(2)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()


def fruit_mesh(size=1.0):
    """Mesh of the right half of the fruit, in µm."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "fruit.msh"
        write_mesh(path, size)
        return load_mesh(path, "mm")


def laws(turgor, skin_modulus=1200.0):
    """Laws by region, of hexagons; walls of the skin are four times as stiff as of `apple`."""
    living = {"turgor": turgor, "arrangement": "hexagon", "sap_bulk_modulus": WATER}
    skin = living_cell("apple", wall_modulus=skin_modulus, **living)
    return {"skin": RveLaw(skin), "flesh": RveLaw(living_cell("apple", **living))}


def plate_below(points):
    """A plate, 5 µm below the lowest of these points (n, 2), µm."""
    return RigidBody(
        name="plate",
        shape=Plane(normal=(0.0, 1.0)),
        on="rim",
        position=(0.0, float(points[:, 1].min()) - 5.0),
        # the default stiffness follows the bulk modulus of water; the flesh is very soft
        stiffness=0.4,  # µN/µm²
        smoothing=10.0,  # µm, as deep as the plate is penetrated
        damping=0.1,  # µN µs/µm²
    )


def dropped(law_of, mesh, duration=2400.0, largest_step=10.0):
    """Run from 5 µm above the plate until the fruit has left it."""
    problem = Problem(
        mesh=mesh,
        conditions=(Symmetry(on="axis"), InitialVelocity(velocity=(0.0, -SPEED))),
        bodies=(plate_below(mesh.p.T),),
        watched={"top": (0.0, float(mesh.p[1].max()))},
        duration=duration,
        output_interval=10.0,
    )
    tissue = RegionalLaw(law_of, points_by_region(mesh, tuple(law_of)))
    settings = MacroSettings(
        integrator="implicit",
        largest_step=largest_step,
        absolute_tolerance=1e-3,
        record_dissipation=False,
    )
    return simulate(problem, tissue, settings)


def stretch_of_walls(run, law_of, mesh):
    """Largest wall length over rest length in each element at each frame, (frames, elements)."""
    F, F_dot = run.frames.F, run.frames.F_dot
    stretch = np.empty(F.shape[:2])
    for name, law in law_of.items():
        elements = mesh.subdomains[name]
        extremes = extremes_of(law, F[:, elements], F_dot[:, elements])
        stretch[:, elements] = extremes["largest_wall_stretch"]
    return stretch


def results(run, law_of):
    """Peak force, µN, and its time and that of the contact, ms; impulse and momentum before, µN µs.

    They are those of the whole fruit.
    """
    force = 2.0 * run.history["force plate y"]
    area = np.pi * (1000.0 * RADIUS) ** 2
    touching = run.curve.t[force > 0.01 * force.max()]
    return {
        "force": force,
        "peak": force.max(),
        "time of the peak": run.curve.t[force.argmax()] / 1000.0,
        "contact": (touching[-1] - touching[0]) / 1000.0,
        "impulse": 2.0 * run.history["impulse plate y"][-1],
        "momentum": law_of["flesh"].density * area * SPEED,
    }


def draw_fruit(axes, run, stretch, t):
    """Draw the whole fruit on its plate at a time, µs, by how much its walls are longer."""
    k = int(abs(run.frames.t - t).argmin())
    moved = {DISPLACEMENT_NAME: run.frames.displacement}
    fields = StoredFields(run.nodes, run.elements, run.frames.t, moved)
    bodies = drawn_bodies([plate_below(run.nodes)], run.curve.t, run.history, fields)
    gain = 100.0 * (stretch[k] / stretch[0] - 1.0)
    colours = Colours.of("longest wall: gain over rest (%)", gain)
    colours.bar(axes, draw_tissue(axes, fields, k, gain, colours, bodies=bodies))
    inner = np.isclose(np.hypot(*run.nodes.T), 1000.0 * (RADIUS - SKIN), rtol=1e-3)
    rim = (run.nodes + run.frames.displacement[k])[inner]
    rim = rim[np.argsort(rim[:, 1])]
    for side in (1.0, -1.0):
        axes.plot(side * rim[:, 0], rim[:, 1], color="white", linewidth=1.2)
    axes.set_title(f"turgor 0.4 MPa, {run.frames.t[k] / 1000.0:.2f} ms", fontsize=9)


if __name__ == "__main__":
    mesh = fruit_mesh()
    print(mesh.nelements, "triangles")
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    curve, specimen = figure.subplots(1, 2, width_ratios=(1.2, 1.0))
    cases = [*((turgor, 1200.0) for turgor in TURGORS), (TURGORS[0], 300.0)]
    for (turgor, skin_modulus), colour in zip(cases, (*PALETTE[:3], None), strict=True):
        law_of = laws(turgor, skin_modulus)
        run = dropped(law_of, mesh, 750.0 / np.sqrt(turgor))  # waves are slower, too
        stretch = stretch_of_walls(run, law_of, mesh)
        hit = results(run, law_of)
        rebound = (hit["impulse"] / hit["momentum"] - 1.0) * SPEED
        print(
            f"turgor {turgor} MPa, walls of the skin {skin_modulus:g} MPa: peak "
            f"{hit['peak']:.0f} µN after {hit['time of the peak']:.2f} ms, contact "
            f"{hit['contact']:.2f} ms, impulse "
            f"{hit['impulse']:.0f} µN µs of {hit['momentum']:.0f}, rebound {rebound:.3f} m/s"
        )
        deepest = run.history["penetration plate"].max()
        print(f"  the plate is penetrated by {deepest:.1f} µm")
        for region in law_of:
            of_region = stretch[:, mesh.subdomains[region]]
            print(f"  {region}: longest wall {of_region[0].max():.4f}, then {of_region.max():.4f}")
        if colour:
            curve.plot(run.curve.t / 1000.0, hit["force"], color=colour, label=f"{turgor:g} MPa")
        if colour == PALETTE[0]:
            draw_fruit(specimen, run, stretch, 1000.0 * hit["time of the peak"])
    curve.set(xlabel="time (ms)", ylabel="force of the plate (µN)", xlim=(0.0, 1.7))
    curve.legend(title="turgor", fontsize=8)
    curve.grid(alpha=0.25)
    Path(__file__).with_suffix(".png").write_bytes(encoded(figure, "png"))

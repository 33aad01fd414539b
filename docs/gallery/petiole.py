"""A petiole of soft flesh between two layers of stiff epidermis is bent, at rest, at four turgors.

`python docs/gallery/petiole.py` prints the page's table and draws petiole.png.
"""

from pathlib import Path

import numpy as np
import skfem
from matplotlib.figure import Figure

from surrofe2 import (
    Box,
    Colours,
    Fixed,
    NodeAt,
    PrescribedMotion,
    Problem,
    RegionalLaw,
    RveLaw,
    SlabLaw,
    Surface,
    draw_tissue,
    drawn_loads,
    fields_at_rest,
    find_rest,
    living_cell,
    points_by_region,
    tabulate_surface,
    with_regions,
)
from surrofe2.run.charts import PALETTE, encoded
from surrofe2.run.journal import BEYOND

TURGORS = (0.05, 0.1, 0.2, 0.4)  # MPa
LENGTH = 20000.0  # µm
HEIGHT = 1200.0  # µm
EPIDERMIS = 150.0  # µm, each: two cells
CORE = HEIGHT - 2.0 * EPIDERMIS
DEFLECTION = 4000.0  # µm, of the tip
TIP = (LENGTH, 0.5 * HEIGHT)
THICKNESS = 10.0  # µm, of the layer that is computed
N_MM = 1e-9 / THICKNESS  # µN µm² of that layer in N mm² per mm of width


def laws(turgor):
    """Laws by region: square cells with stiff walls along the petiole around hexagons."""
    epidermis = living_cell(
        "apple", turgor=turgor, arrangement="square", cell_size=75.0, wall_modulus=600.0
    )
    core = living_cell("apple", turgor=turgor, arrangement="hexagon")
    outside = RveLaw(epidermis)
    return {"upper": outside, "core": RveLaw(core), "lower": outside}


def petiole_mesh(along=40):
    """Mesh of the petiole: one element across each epidermis, two across the core."""
    x = np.linspace(0.0, LENGTH, along + 1)
    y = np.array([0.0, EPIDERMIS, 0.5 * HEIGHT, HEIGHT - EPIDERMIS, HEIGHT])
    mesh = skfem.MeshQuad1.init_tensor(x, y).with_defaults()
    return with_regions(
        mesh,
        lower=Box((0.0, 0.0), (LENGTH, EPIDERMIS)),
        core=Box((0.0, EPIDERMIS), (LENGTH, HEIGHT - EPIDERMIS)),
        upper=Box((0.0, HEIGHT - EPIDERMIS), (LENGTH, HEIGHT)),
    )


def bent(law_of, deflection=DEFLECTION, steps=20, mesh=None, surface=None):
    """Rest of the petiole, clamped at its left end, when its tip has come down by `deflection`."""
    mesh = mesh or petiole_mesh()
    tip = PrescribedMotion(name="tip", on=NodeAt(TIP), displacement=(None, -deflection))
    problem = Problem(
        mesh=mesh, conditions=(Fixed(on="left"), tip), watched={"tip": TIP}, surface=surface
    )
    tissue = RegionalLaw(law_of, points_by_region(mesh, tuple(law_of)))
    return find_rest(problem, tissue, load_steps=steps)


def rigidity(rest):
    """Flexural rigidity F L³/(3 w) from the first load step, N mm² per mm of width."""
    columns = rest.columns
    force = columns["force tip y"][1]
    deflection = columns["displacement tip y"][1] - columns["displacement tip y"][0]
    return force / deflection * LENGTH**3 / 3.0 * N_MM


def moduli(law):
    """Young's modulus along x and shear modulus of a law at rest, µN/µm."""
    A = law.respond(np.eye(2)[None], np.zeros((1, 2, 2)), tangents=True).tangents.P_by_F[0]
    return A[0, 0, 0, 0] - A[0, 0, 1, 1] ** 2 / A[1, 1, 1, 1], A[0, 1, 0, 1]


def sides_of(law_of, strain=0.01):
    """Table of the surface law of the epidermis, for strains up to `strain`."""
    epidermis = law_of["upper"]
    slab = SlabLaw(epidermis.cell, reference=epidermis.reference)
    return tabulate_surface(slab, (1.0 - strain, 1.0 + strain), 1e-3)


def layered_beam(law_of, sides=None):
    """The rigidity that a layered beam shows, N mm² per mm of width; `sides`: with this law."""
    stiff, _ = moduli(law_of["upper"])
    soft, shear = moduli(law_of["core"])
    EI = stiff * (HEIGHT**3 - CORE**3) / 12.0 + soft * CORE**3 / 12.0
    if sides is not None:
        slope = sides.respond(np.ones(1), np.zeros(1), tangents=True).tangent[0]
        EI += 2.0 * slope * (0.5 * HEIGHT - sides.depth) ** 2
    # the core bears the shear
    return EI / (1.0 + 3.0 * EI / (shear * HEIGHT * LENGTH**2)) * N_MM


def draw_petiole(axes, rest):
    """Draw the bent petiole with clamp and pull, by the stress along it."""
    fields = fields_at_rest(rest)
    stress = rest.element_stress[:, 0, 0] / THICKNESS
    colours = Colours.of("stress along the petiole (MPa)", stress)
    nodes = drawn_loads(rest.system.problem, fields)
    colours.bar(axes, draw_tissue(axes, fields, 1, stress, colours, nodes=nodes))


if __name__ == "__main__":
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=(1.0, 1.3))
    specimen = above.subplots()
    curves, rigidities = below.subplots(1, 2, width_ratios=(1.3, 1.0))
    computed = []
    beams = []
    with_sides = []
    for turgor, colour in zip(TURGORS, PALETTE, strict=False):
        law_of = laws(turgor)
        rest = bent(law_of)
        deflection = -rest.columns["displacement tip y"] / 1000.0
        force = -rest.columns["force tip y"]
        first = np.flatnonzero(rest.columns[BEYOND] > 0)[:1]
        curves.plot(deflection, force, color=colour, label=f"{turgor:g} MPa")
        curves.plot(deflection[first], force[first], "o", color=colour)
        computed.append(rigidity(rest))
        beams.append(layered_beam(law_of))
        with_sides.append(layered_beam(law_of, sides_of(law_of, 0.04 * turgor)))
        print(
            f"{turgor} MPa: rigidity {computed[-1]:.3f}, layered beam {beams[-1]:.3f}, with the "
            f"surface law {with_sides[-1]:.3f}; first buckling at {deflection[first]} mm; "
            f"{force[-1]:.1f} µN at {deflection[-1]:.1f} mm"
        )
        if turgor == 0.1:
            draw_petiole(specimen, rest)
    sides = Surface(
        law=dict.fromkeys(("upper", "lower"), sides_of(law_of, 0.02)), on=("top", "bottom")
    )
    sided = rigidity(bent(law_of, 100.0, 1, surface=sides))
    print(f"{turgor} MPa: FE² with the surface law {sided:.3f}")
    curves.set(
        xlabel="deflection of the tip (mm)", ylabel="force on the tip (µN)", ylim=(0.0, None)
    )
    curves.legend(title="turgor", fontsize=8)
    rigidities.plot(TURGORS, beams, "-", color="0.6", label="layered beam")
    rigidities.plot(TURGORS, with_sides, "--", color="0.6", label="the same, with free sides")
    rigidities.plot(TURGORS, computed, "o", color="0.2", label="FE²")
    rigidities.plot(TURGORS[-1:], [sided], "s", color="0.2", label="FE² with [surface]")
    rigidities.set(
        xlabel="turgor (MPa)", ylabel="flexural rigidity\n(N mm² per mm of width)", ylim=(0.0, None)
    )
    rigidities.legend(fontsize=8)
    for axes in (curves, rigidities):
        axes.grid(alpha=0.25)
    Path(__file__).with_suffix(".png").write_bytes(encoded(figure, "png"))

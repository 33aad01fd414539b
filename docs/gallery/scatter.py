"""Irregular apple tissue in tension: how much its stiffness scatters over arrangements of cells.

`python docs/gallery/scatter.py` prints the page's table and draws scatter.png.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from surrofe2 import (
    Fixed,
    InputError,
    NodeAt,
    PrescribedMotion,
    Problem,
    RveLaw,
    Symmetry,
    draw_cells,
    find_rest,
    living_cell,
    rectangle,
)
from surrofe2.run.charts import BLUE, VERMILION, encoded

SIDE = 1500.0  # µm, of a square piece of tissue: one element, for its strain is even
THICKNESS = 10.0  # µm, of the layer that is computed
STRAIN = 0.10
SMALL = 0.005  # strain at which the modulus is measured
CELLS = (9, 16, 36)  # plant cells per RVE
SEEDS = 8  # arrangements of each number of cells


def irregular(cells, seed):
    """Law of RVEs of Voronoi cells whose areas vary by 25 %."""
    cell = living_cell(
        "apple", arrangement="voronoi", cells=cells, arrangement_seed=seed, area_variation=0.25
    )
    return RveLaw(cell)


def arrangements(cells, count=SEEDS):
    """The first `count` laws that have a rest, by seed; seeds without one are printed."""
    laws = {}
    seed = 1
    while len(laws) < count:
        try:
            laws[seed] = irregular(cells, seed)
        except InputError as error:
            print(f"{cells} cells, seed {seed}: {error}")
        seed += 1
    return laws


def pulled(law, strain=STRAIN, steps=10):
    """Piece at rest whose right side has moved in x; it is free to thin and to shear."""
    pull = PrescribedMotion(name="pull", on="right", displacement=(strain * SIDE, None))
    corner = Fixed(name="corner", on=NodeAt((0.0, 0.0)), components="y")
    problem = Problem(
        mesh=rectangle(SIDE, SIDE, (1, 1)),
        conditions=(Symmetry(on="left"), corner, pull),
        watched={"right": (SIDE, 0.0)},
    )
    return find_rest(problem, law, load_steps=steps)


def stress_over_strain(rest, strain=STRAIN, steps=10):
    """Strains, and stresses in MPa of the undeformed section, (steps + 1,) each."""
    factors = np.linspace(0.0, 1.0, steps + 1)
    # a load step that was halved left more rows
    force = np.interp(factors, rest.columns["t"], rest.columns["force pull x"])
    return strain * factors, force / (SIDE * THICKNESS)


def modulus(law):
    """Young's modulus along x, MPa, at small strain."""
    stress = stress_over_strain(pulled(law, SMALL, 1), SMALL, 1)[1]
    return stress[-1] / SMALL


if __name__ == "__main__":
    figure = Figure(figsize=(12.0, 3.8), layout="constrained")
    tissue, curves, moduli = figure.subplots(1, 3, width_ratios=(1.2, 1.0, 0.9))
    stresses = []
    for cells in CELLS:
        laws = arrangements(cells)
        values = np.array([modulus(law) for law in laws.values()])
        mean, deviation = values.mean(), values.std(ddof=1)
        print(f"{cells} cells, seeds {[*laws]}: {mean:.2f} MPa ± {100 * deviation / mean:.1f} %")
        moduli.plot(np.full(SEEDS, cells), values, "o", color="0.6", markersize=4.0)
        moduli.errorbar(cells, mean, yerr=deviation, fmt="s", color=BLUE, capsize=4.0)
        if cells == CELLS[0]:
            for law in laws.values():
                rest = pulled(law)
                strain, stress = stress_over_strain(rest)
                curves.plot(100 * strain, stress, color="0.7", linewidth=0.8)
                stresses.append(stress)
            first = next(iter(laws.values()))
            seen = first.particles(pulled(first).F[:1], np.zeros((1, 2, 2)))
            (walls, lines), (fluid, areas) = draw_cells(tissue, seen, 0)
            left, right = tissue.get_xlim()
            y = float(seen.position[0].mean(axis=0)[1])
            for x, direction in ((left, -1.0), (right, 1.0)):
                arrow = {"arrowstyle": "-|>", "color": VERMILION, "linewidth": 2.0}
                tissue.annotate("", (x + 90.0 * direction, y), (x, y), arrowprops=arrow)
            tissue.set_xlim(left - 100.0, right + 100.0)
            walls.bar(tissue, lines)
            fluid.bar(tissue, areas, "left")
            tissue.set_title(f"one arrangement, pulled by {100 * STRAIN:g} %", fontsize=9)

    mean = np.mean(stresses, axis=0)
    deviation = np.std(stresses, axis=0, ddof=1)
    print(f"stress at 10 %: {mean[-1]:.3f} MPa ± {100 * deviation[-1] / mean[-1]:.1f} %")
    curves.fill_between(100 * strain, mean - deviation, mean + deviation, color=BLUE, alpha=0.25)
    curves.plot(100 * strain, mean, color=BLUE, label="mean ± standard deviation")
    hexagons = RveLaw(living_cell("apple", arrangement="hexagon"))
    regular = stress_over_strain(pulled(hexagons))[1]
    print(f"hexagons: {modulus(hexagons):.2f} MPa, {regular[-1]:.3f} MPa at 10 %")
    curves.plot(100 * strain, regular, "--", color=VERMILION, label="hexagons")
    curves.set(xlabel="strain (%)", ylabel="stress (MPa)")
    curves.set_title(f"{SEEDS} arrangements of {CELLS[0]} cells", fontsize=9)
    curves.legend(fontsize=8)
    moduli.set(xlabel="plant cells per RVE", ylabel="Young's modulus (MPa)", xticks=CELLS)
    moduli.set_title("dot: one arrangement", fontsize=9)
    for axes in (curves, moduli):
        axes.grid(alpha=0.25)
    Path(__file__).with_suffix(".png").write_bytes(encoded(figure, "png"))

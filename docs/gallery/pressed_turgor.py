"""Parenchyma pressed by 15 % at four turgors, at rest: stress over strain, and where cells buckle.

`python docs/gallery/pressed_turgor.py` prints the page's table and draws pressed_turgor.png.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from surrofe2 import Fixed, PrescribedMotion, Problem, RveLaw, find_rest, living_cell, rectangle
from surrofe2.run.charts import PALETTE, encoded
from surrofe2.run.journal import BEYOND

TURGORS = (0.05, 0.1, 0.2, 0.4)  # MPa
SIDE = 3000.0  # µm, of a square block: 20 plant cells
STRAIN = 0.15
THICKNESS = 10.0  # µm, of the layer that is computed
DRAWN = {"hexagon": "-", "square": "--"}


def pressed(turgor, arrangement, elements=(4, 4), steps=30):
    """Strains, stresses in MPa, and how many points have buckled, after each load step."""
    plate = PrescribedMotion(name="plate", on="top", displacement=(0.0, -STRAIN * SIDE))
    problem = Problem(
        mesh=rectangle(SIDE, SIDE, elements),
        conditions=(Fixed(on="bottom"), plate),
        watched={"top": (0.5 * SIDE, SIDE)},
    )
    cell = living_cell("apple", turgor=turgor, arrangement=arrangement)
    columns = find_rest(problem, RveLaw(cell), load_steps=steps).columns
    stress = -columns["force plate y"] / (SIDE * THICKNESS)
    return STRAIN * columns["t"], stress, columns[BEYOND]


if __name__ == "__main__":
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    curves, moduli = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    for arrangement, dashes in DRAWN.items():
        slopes = []
        for turgor, colour in zip(TURGORS, PALETTE, strict=False):
            strain, stress, buckled = pressed(turgor, arrangement)
            first = np.flatnonzero(buckled > 0)[:1]
            slopes.append(stress[1] / strain[1])
            begins = "".join(f", first buckling at {100 * strain[k]:.3g} %" for k in first)
            print(f"{arrangement}, {turgor} MPa: modulus {slopes[-1]:.3g} MPa{begins}")
            name = f"{turgor:g} MPa" if arrangement == "hexagon" else None
            curves.plot(100 * strain, stress, dashes, color=colour, label=name)
            curves.plot(100 * strain[first], stress[first], "o", color=colour, zorder=3)
        moduli.plot(TURGORS, slopes, f"{dashes}o", color="0.3", label=f"{arrangement}s")
    curves.set(xlabel="compression (%)", ylabel="stress (MPa)", ylim=(0.0, None))
    curves.set_title(
        "hexagons: full lines, squares: dashes, dot: cells begin to buckle", fontsize=9
    )
    curves.legend(title="turgor", fontsize=8)
    moduli.set(xlabel="turgor (MPa)", ylabel="modulus at the start (MPa)", ylim=(0.0, None))
    moduli.legend(fontsize=8)
    for axes in (curves, moduli):
        axes.grid(alpha=0.25)
    Path(__file__).with_suffix(".png").write_bytes(encoded(figure, "png"))

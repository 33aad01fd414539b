"""What the four initialisations do to one RVE: two pictures of docs/explanation.

`python docs/plots/initialisations.py` draws docs/initialisations.png and
docs/initialisations-particles.png.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from surrofe2 import CellParameters, RveLaw, draw_cells
from surrofe2.run.charts import GREEN, VERMILION, Curve, Panel, draw_panels, encoded
from surrofe2.rve import INITIALISATIONS
from surrofe2.rve.micro_integration import integrate_rve

DOCS = Path(__file__).parents[1]
CELL = CellParameters.preset("water")
PERIOD, SHEAR, STRETCH = 40.0, 0.05, 0.04  # µs, 1, 1
ARROW = {"scale_units": "xy", "angles": "xy", "width": 0.009, "minlength": 0.3, "zorder": 5}
VELOCITY, FORCE = 0.05, 50.0  # µm/µs and µN of an arrow of 2 µm


def path(t):
    """(F, Ḟ) at time t in µs: shear and stretch that oscillate."""
    w = 2.0 * np.pi / PERIOD
    direction = np.array([[STRETCH, SHEAR], [0.0, 0.0]])
    return np.eye(2) + np.sin(w * t) * direction, w * np.cos(w * t) * direction


def stress_along(name, times):
    """(m, 2, 2) MPa by an initialisation, each point from the state of the one before."""
    law = RveLaw(CELL, initialisation=name)
    state = None
    stresses = []
    for t in times:
        F, F_dot = path(t)
        answer = law.respond(F[None], F_dot[None], state)
        state = answer.state
        stresses.append(answer.stress[0] / CELL.tissue_thickness)
    return np.array(stresses)


def draw_errors():
    """Shear stress over time, and the error of each initialisation."""
    times = np.linspace(0.0, 0.75 * PERIOD, 121)
    exact = integrate_rve(RveLaw(CELL), path, times, 1e-3) / CELL.tissue_thickness
    late = times > 2.0  # the integrated RVE starts at rest
    stress = {name: stress_along(name, times) for name in INITIALISATIONS}
    errors = {name: np.linalg.norm(s - exact, axis=(1, 2))[late] for name, s in stress.items()}
    label, born = "integrated in time, and the three others", "cauchy-born"
    above = (
        Curve("micro-integration", times, exact[:, 0, 1], label, markers=False),
        Curve(born, times, stress[born][:, 0, 1], markers=False),
    )
    below = (Curve(name, times[late], error, markers=False) for name, error in errors.items())
    panels = (
        Panel("time (µs)", "shear stress (MPa)", above),
        Panel("time (µs)", "error of the stress (MPa)", tuple(below), log_y=True),
    )
    (DOCS / "initialisations.png").write_bytes(encoded(draw_panels(panels, 2), "png"))
    for name, error in errors.items():
        print(f"{name:17} largest error {error.max():.2g} MPa")


def draw_particles():
    """Where particles are, and where they go, under a fast shear."""
    F = np.array([[[1.0, 0.1], [0.0, 1.0]]])
    F_dot = np.array([[[0.0, 0.05], [0.0, 0.0]]])
    figure = Figure(figsize=(11.0, 3.3), layout="constrained")
    places = figure.subplots(1, 4)
    for axes, name in zip(places, INITIALISATIONS, strict=True):
        seen = RveLaw(CELL, initialisation=name).particles(F, F_dot)
        x, v, f = seen.position[0], seen.velocity[0], seen.force[0]
        own = v - x @ (F_dot[0] @ np.linalg.inv(F[0])).T
        bars = draw_cells(axes, seen, 0, half=17.0)
        axes.quiver(*x.T, *own.T, color=GREEN, scale=VELOCITY / 2.0, **ARROW)
        axes.quiver(*x.T, *f.T, color=VERMILION, scale=FORCE / 2.0, **ARROW)
        mean = np.linalg.norm(f, axis=1).mean()
        words = Curve(name, np.zeros(0), np.zeros(0)).words
        axes.set_title(f"{words}\nmean force {mean:.1f} µN", fontsize=9)
        print(f"{name:17} mean force {mean:.2g} µN, own velocity {np.abs(own).max():.2g} µm/µs")
    for colours, drawn in bars:
        colours.bar(places, drawn)
    figure.supxlabel(
        f"arrows of 2 µm: green, a velocity of {VELOCITY:g} µm/µs beside that of the tissue; "
        f"vermilion, a force of {FORCE:g} µN",
        fontsize=9,
    )
    (DOCS / "initialisations-particles.png").write_bytes(encoded(figure, "png"))


if __name__ == "__main__":
    draw_errors()
    draw_particles()

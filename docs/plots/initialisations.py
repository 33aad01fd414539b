"""What the four initialisations do to one RVE: two pictures of docs/explanation.

`python docs/plots/initialisations.py` draws docs/initialisations.png and
docs/initialisations-particles.png.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from surrofe2 import CellParameters, RveLaw
from surrofe2.rve import INITIALISATIONS
from surrofe2.rve.micro_integration import integrate_rve

DOCS = Path(__file__).parents[1]
CELL = CellParameters.preset("water")
PERIOD, SHEAR, STRETCH = 40.0, 0.05, 0.04  # µs, 1, 1
COLOURS = dict(zip(INITIALISATIONS, ("#999999", "#d55e00", "#0072b2", "#009e73"), strict=True))


def path(t):
    """(F, Ḟ) at time t in µs: shear and stretch that oscillate."""
    w = 2.0 * np.pi / PERIOD
    direction = np.array([[STRETCH, SHEAR], [0.0, 0.0]])
    return np.eye(2) + np.sin(w * t) * direction, w * np.cos(w * t) * direction


def stress_along(name, times):
    """(m, 2, 2) µN/µm by an initialisation, each point from the state of the one before."""
    law, state, found = RveLaw(CELL, initialisation=name), None, []
    for t in times:
        F, F_dot = path(t)
        answer = law.respond(F[None], F_dot[None], state)
        state = answer.state
        found.append(answer.stress[0])
    return np.array(found)


def draw_errors():
    """Shear stress over time, and the error of each initialisation."""
    times = np.linspace(0.0, 0.75 * PERIOD, 121)
    true = integrate_rve(RveLaw(CELL), path, times, 1e-3)
    figure = Figure(figsize=(7.2, 5.4), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    above.plot(times, true[:, 0, 1], "k", lw=3, alpha=0.35, label="integrated in time")
    for name in INITIALISATIONS:
        stress = stress_along(name, times)
        above.plot(times, stress[:, 0, 1], color=COLOURS[name], lw=1.2, label=name)
        error = np.linalg.norm(stress - true, axis=(1, 2))
        late = times > 2.0  # the integrated RVE starts at rest
        below.semilogy(times[late], error[late], color=COLOURS[name], lw=1.5)
        print(f"{name:17} largest error {error[late].max():.2g} µN/µm")
    above.set_ylabel("shear stress (µN/µm)")
    above.legend(ncols=2, fontsize=8, frameon=False)
    below.set(xlabel="time (µs)", ylabel="error of the stress (µN/µm)")
    figure.savefig(DOCS / "initialisations.png", dpi=140)


def draw_particles():
    """Where particles are, and where they go, under a fast shear."""
    F = np.array([[[1.0, 0.1], [0.0, 1.0]]])
    F_dot = np.array([[[0.0, 0.05], [0.0, 0.0]]])
    figure = Figure(figsize=(9.6, 2.7), layout="constrained")
    for axes, name in zip(figure.subplots(1, 4, sharey=True), INITIALISATIONS, strict=True):
        seen = RveLaw(CELL, initialisation=name).particles(F, F_dot)
        x, v, f = seen.position[0], seen.velocity[0], seen.force[0]
        own = v - x @ (F_dot[0] @ np.linalg.inv(F[0])).T
        wall = x[seen.is_wall]
        box = F[0] @ seen.lattice
        shifts = [(0, 0), (1, 0), (0, 1), (1, 1)]  # walls of the neighbours close the plant cell
        walls = np.concatenate([wall + box @ shift for shift in shifts])
        near = (walls @ np.linalg.inv(box).T < 1.05).all(axis=1)
        axes.plot(*walls[near].T, "s", ms=3, color="#8a6d3b")
        axes.plot(*x[~seen.is_wall].T, "o", ms=5, color="#56b4e9")
        axes.quiver(*x.T, *own.T, color="#009e73", scale=1.0, width=0.009)
        axes.quiver(*x.T, *f.T, color="#d55e00", scale=300.0, width=0.009)
        mean = np.linalg.norm(f, axis=1).mean()
        axes.set_title(f"{name}\nmean force {mean:.1f} µN", fontsize=9)
        axes.set(aspect="equal", xticks=[], yticks=[], xlim=(-4, 32), ylim=(-4, 29))
        axes.spines[:].set_visible(False)
        print(f"{name:17} mean force {mean:.2g} µN, own velocity {np.abs(own).max():.2g} µm/µs")
    figure.savefig(DOCS / "initialisations-particles.png", dpi=140)


if __name__ == "__main__":
    draw_errors()
    draw_particles()

"""Draws the picture of an example: a recipe from Python, `python examples/picture.py NAME …`."""

import sys
from pathlib import Path

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from surrofe2 import RveLaw, simulate
from surrofe2.recipe import load_recipe

FOLDER = Path(__file__).parent
CURVES = {  # name: (over, force on the tissue, sign that makes it positive)
    "block-between-plates": ("mean displacement top y", "force upper y", -1.0),
    "drop-on-plate": ("time", "force plate y", 1.0),
    "tensile-strip": ("time", "force clamp x", -1.0),
    "notched-leaf": ("time", "force clamp x", -1.0),
    "hexagons-in-tension": ("time", "force grip x", 1.0),
}


def draw(name, run, path):
    """Force over time or displacement; the deformed mesh when the force is largest."""
    over, which, sign = CURVES[name]
    force = sign * run.history[which]
    x = run.curve.t if over == "time" else run.history[over]
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(x, force, color="#0072B2")
    left.set_xlabel("time (µs)" if over == "time" else f"{over} (µm)")
    left.set_ylabel(f"{which} (µN)")
    peak = run.curve.t[force.argmax()]
    k = abs(run.frames.t - peak).argmin()
    corners = run.elements[:, : 3 if run.elements.shape[1] == 6 else 4]
    places = (run.nodes + run.frames.displacement[k])[corners]
    largest = np.linalg.eigvalsh(run.frames.stress[k])
    shown = np.take_along_axis(largest, abs(largest).argmax(axis=1)[:, None], axis=1)[:, 0]
    tissue = PolyCollection(places, array=shown, cmap="viridis", edgecolor="black", linewidth=0.4)
    right.add_collection(tissue)
    right.autoscale()
    right.set_aspect("equal")
    right.set_xlabel(f"x (µm), at {run.frames.t[k]:.3g} µs")
    figure.colorbar(tissue, ax=right, label="principal stress of\nlargest size (µN/µm)")
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    for name in sys.argv[1:] or CURVES:
        recipe = load_recipe(FOLDER / f"{name}.toml")
        law = RveLaw(recipe.cell, initialisation=recipe.rve.initialisation)
        draw(name, simulate(recipe.problem(), law, recipe.macro), FOLDER / f"{name}.png")

"""The cells of an image under load, and FE² with an RVE that is like them.

`python docs/gallery/image_to_modulus.py` prints the page's figures and draws image_to_modulus.png.
"""

from pathlib import Path

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from surrofe2 import Colours, RveLaw, draw_scale_bar, find_rest, load_recipe, simulate_tissue
from surrofe2.run.charts import BLUE, VERMILION, encoded
from surrofe2.store.labelled_image import read_labels
from surrofe2.workflow.tissue import tissue_of

FOLDER = Path(__file__).parent
RECIPE = FOLDER / "image_to_modulus.toml"


def polygons(outlined, at):
    """The wall particles (k, 2) around each plant cell; a particle's number is that in the image's
    arrangement, as its whole tissue is one period."""
    cells = zip(outlined.arrangement.rims, outlined.is_cell, strict=True)
    return [at[rim[:, 0]] for rim, is_cell in cells if is_cell]


def areas(rims):
    """Areas of polygons, µm²."""
    following = [np.roll(rim, -1, axis=0) for rim in rims]
    pairs = zip(rims, following, strict=True)
    return np.array([0.5 * np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) for a, b in pairs])


def colour_numbers(labels):
    """Numbers (rows, columns) from 0 on, which differ where two cells touch, for their colours."""
    neighbours = {label: set() for label in np.unique(labels).tolist()}
    for first, second in ((labels[:-1], labels[1:]), (labels[:, :-1], labels[:, 1:])):
        touching = first != second
        pairs = np.stack([first[touching], second[touching]], axis=1)
        for one, other in np.unique(pairs, axis=0).tolist():
            neighbours[one].add(other)
            neighbours[other].add(one)
    numbers = {}
    for label, beside in neighbours.items():
        taken = {numbers[each] for each in beside if each in numbers}
        numbers[label] = min(set(range(len(taken) + 1)) - taken)
    return np.vectorize(numbers.get)(labels)


def by_rves(recipe):
    """Displacement of the plate in µm and its force in µN after each load step of FE²."""
    cell = recipe.study().cell.parameters
    rest = find_rest(recipe.problem(), RveLaw(cell), load_steps=recipe.rest.load_steps)
    return rest.columns["t"] * 30.0, -rest.columns["force plate y"]


if __name__ == "__main__":
    recipe = load_recipe(RECIPE)
    tissue = tissue_of(recipe)
    run = simulate_tissue(
        tissue.problem, tissue.cells, recipe.tissue, kind=None, outlined=tissue.outlined
    )
    moved = -run.history["mean displacement top y"]
    force = -run.history["force plate y"]
    fe2_moved, fe2_force = by_rves(recipe)
    last, fe2_last = force[-1], fe2_force[-1]
    print(f"force at 5 %: cells of the image {last:.0f} µN, FE² {fe2_last:.0f} µN")
    print(f"modulus of FE² at the start: {fe2_force[1] / fe2_moved[1] * 600 / 900 / 10:.3g} MPa")

    figure = Figure(figsize=(11.0, 3.6), layout="constrained")
    image, cells, curve = figure.subplots(1, 3, width_ratios=(1.2, 1.45, 1.0))
    labels = read_labels(FOLDER / recipe.image.file)
    image.imshow(colour_numbers(labels), cmap="Set3", vmin=0, vmax=11, extent=(0, 900, 0, 600))
    image.set_title("labelled image", fontsize=9)
    draw_scale_bar(image, np.zeros(2), np.array([900.0, 600.0]))
    rims = polygons(tissue.outlined, run.position + run.frames.displacement[-1])
    cell = tissue.cells[0]
    laid_out = areas(polygons(tissue.outlined, tissue.outlined.arrangement.wall_position))
    pressure = cell.fluid_density * cell.sound_speed**2 * laid_out / areas(rims) / 10.0
    colours = Colours.of("pressure of the sap (MPa)", pressure, "Blues")
    drawn = PolyCollection(rims, edgecolors="black", linewidths=0.9)
    colours.bar(cells, cells.add_collection(colours.paint(drawn, pressure)))
    for y in (0.0, 570.0):
        cells.plot([0.0, 900.0], [y, y], color="0.15", linewidth=3.0)
    every = np.concatenate(rims)
    margin = 6.0  # µm, for half of the width of a line
    draw_scale_bar(cells, every.min(axis=0) - margin, every.max(axis=0) + margin)
    cells.set_title("its cells, pressed by 5 %", fontsize=9)
    curve.plot(moved, force, color=BLUE, label="cells of the image")
    curve.plot(fe2_moved, fe2_force, "o--", color=VERMILION, markersize=4.0, label="FE²")
    curve.set(xlabel="displacement of the plate (µm)", ylabel="force on the plate (µN)")
    curve.legend(fontsize=8)
    curve.grid(alpha=0.25)
    (FOLDER / "image_to_modulus.png").write_bytes(encoded(figure, "png"))

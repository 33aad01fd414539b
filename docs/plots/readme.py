"""The picture of README: apple tissue under a disc, and the plant cells of two of its elements.

`python docs/plots/readme.py` draws docs/readme.png. The test is that of the gallery's page
docs/gallery/puncture.md.
"""

from pathlib import Path
from runpy import run_path
from types import SimpleNamespace

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import ConnectionPatch

from surrofe2 import draw_cells
from surrofe2.run.charts import VERMILION, encoded

DOCS = Path(__file__).parents[1]
puncture = SimpleNamespace(**run_path(str(DOCS / "gallery" / "puncture.py")))


def places_of_cells(rest):
    """Centres, as deformed, of the elements whose cells are drawn: skin, then flesh."""
    space = rest.system.discretisation
    moved = space.nodes + rest.displacement.reshape(-1, 2)
    at_rest = space.nodes[space.elements].mean(axis=1)
    column = np.flatnonzero(np.isclose(at_rest[:, 0], at_rest[:, 0].min()))
    highest_first = column[np.argsort(-at_rest[column, 1])]
    return moved[space.elements[highest_first[:2]]].mean(axis=1)


def main():
    """Press the disc into the tissue at rest, and draw the whole specimen and its cells."""
    laws = puncture.laws()
    rest, ending = puncture.pressed(laws, puncture.half_mesh())
    figure = Figure(figsize=(8.6, 4.4), layout="constrained")
    rows = [["specimen", "skin"], ["specimen", "flesh"]]
    places = figure.subplot_mosaic(rows, width_ratios=(1.35, 0.55))
    puncture.draw_specimen(places["specimen"], rest)
    cells = puncture.cells_below(rest, laws)
    panels = [places["skin"], places["flesh"]]
    centres = places_of_cells(rest)
    for axes, seen, centre, name in zip(panels, cells, centres, laws, strict=True):
        (_, lines), (_, areas) = draw_cells(axes, seen, 0, half=230.0)
        puncture.STRETCH.paint(lines, lines.get_array())
        puncture.PRESSURE.paint(areas, areas.get_array())
        axes.set_title(f"cells of the {name}", fontsize=9)
        pointer = ConnectionPatch(
            centre,
            (0.0, 0.5),
            coordsA="data",
            coordsB="axes fraction",
            axesA=places["specimen"],
            axesB=axes,
            color=VERMILION,
            linewidth=1.0,
        )
        figure.add_artist(pointer)
        places["specimen"].plot(*centre, "s", color=VERMILION, markersize=5.0, fillstyle="none")
    puncture.STRETCH.bar(panels, lines)
    puncture.PRESSURE.bar(panels, areas)
    (DOCS / "readme.png").write_bytes(encoded(figure, "png"))
    print(f"{rest.columns['t'][-1]:g} of the depth, ended by {ending}")


if __name__ == "__main__":
    main()

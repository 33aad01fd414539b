"""The picture of README: a bar under more load than its surrogate was made for.

`python docs/plots/readme.py` draws docs/readme.png. It needs training/bending-bar.h5
(`surrofe2 study data/bending-bar.toml`).
"""

from pathlib import Path

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import ConnectionPatch, Patch

from surrofe2 import CachedLaw, CellParameters, LoadCase, RveLaw, read_surrogate, simulate
from surrofe2.report.figures import Colours, draw_cells, draw_tissue
from surrofe2.run.charts import VERMILION, encoded
from surrofe2.store.fields import DISPLACEMENT_NAME, StoredFields

ROOT = Path(__file__).parents[2]
SOURCES = {"surrogate": "#9ecae1", "RVE, outside the trusted range": VERMILION}


def main():
    """Run the bar by the cache and draw the frame with the most elements by RVEs."""
    law = RveLaw(CellParameters.preset("printed"))
    cached = CachedLaw(read_surrogate(ROOT / "training" / "bending-bar.h5"), law)
    bar = LoadCase(elements=(16, 16), body_force=(0.0, -0.45), duration=27.0)
    run = simulate(bar, cached)
    frames, by_rve = run.frames, run.frames.source != 0
    k = int(by_rve.sum(axis=1).argmax())
    fields = StoredFields(
        run.nodes, run.elements, frames.t, {DISPLACEMENT_NAME: frames.displacement}
    )
    figure = Figure(figsize=(8.0, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    draw_tissue(left, fields, k, by_rve[k] * 1.0, Colours("", 0.0, 1.0, "viridis"))
    for each in left.collections:
        each.set(cmap=ListedColormap([*SOURCES.values()]))
    handles = [Patch(color=colour, label=name) for name, colour in SOURCES.items()]
    left.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.02), frameon=False,
                ncols=2, title="Where the stress comes from")  # fmt: skip

    strain = np.abs(frames.F[k] - np.eye(2)).max(axis=(1, 2))
    element = int(np.where(by_rve[k], strain, -1.0).argmax())
    seen = law.particles(frames.F[k, element][None], frames.F_dot[k, element][None])
    (walls, lines), (fluid, dots) = draw_cells(right, seen, 0, law.cell.tissue_thickness, half=26.0)
    walls.bar(right, lines, "bottom")
    fluid.bar(right, dots)
    corners = (fields.points + fields.displacement[k])[run.elements[element]]
    pointer = ConnectionPatch(
        corners.mean(axis=0), (0.0, 0.6), coordsA="data", coordsB="axes fraction",
        axesA=left, axesB=right, color=VERMILION, linewidth=1.0,
    )  # fmt: skip
    figure.add_artist(pointer)
    (ROOT / "docs" / "readme.png").write_bytes(encoded(figure, "png"))
    print(f"{frames.t[k]:.1f} µs, {by_rve[k].sum()} of {by_rve.shape[1]} elements by RVEs")


if __name__ == "__main__":
    main()

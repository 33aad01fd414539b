"""The picture of README: a bar under more load than its surrogate was made for.

`python docs/plots/readme.py` draws docs/readme.png. It needs training/bending-bar.h5
(`surrofe2 study data/bending-bar.toml`).
"""

from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import ConnectionPatch, Patch

from surrofe2 import CachedLaw, CellParameters, LoadCase, RveLaw, read_surrogate, simulate

ROOT = Path(__file__).parents[2]
COLOURS = ("#9ecae1", "#d55e00")
TILES = 2


def tissue(place, run, k):
    """The deformed elements by the source of their stress, the clamp, the undeformed outline."""
    corners = (run.nodes + run.frames.displacement[k])[run.elements[:, :4]]
    by_rve = run.frames.source[k] != 0
    elements = PolyCollection(
        corners, array=by_rve.astype(float), cmap=ListedColormap(COLOURS), clim=(0.0, 1.0),
        edgecolor="white", linewidth=0.5,
    )  # fmt: skip
    place.add_collection(elements)
    low, high = run.nodes.min(axis=0), run.nodes.max(axis=0)
    outline = np.array([low, (high[0], low[1]), high, (low[0], high[1]), low])
    place.plot(*outline.T, color="0.6", linestyle="--", linewidth=0.8)
    place.fill_betweenx([low[1], high[1]], -18.0, 0.0, hatch="////", facecolor="none",
                        edgecolor="0.4", linewidth=0.0)  # fmt: skip
    place.plot([0.0, 0.0], [low[1], high[1]], color="0.2", linewidth=1.5)
    place.set_aspect("equal")
    place.axis("off")
    names = ("surrogate", "RVE, outside the trusted range")
    handles = [Patch(color=colour, label=name) for colour, name in zip(COLOURS, names, strict=True)]
    place.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), frameon=False,
                 ncols=2, title="Where the stress comes from")  # fmt: skip
    place.plot([0.0, 100.0], [-70.0, -70.0], color="black", linewidth=2.5)
    place.text(50.0, -78.0, "100 µm", ha="center", va="top")
    return corners, by_rve


def cells(place, law, F, F_dot):
    """Plant cells of one RVE, repeated: walls by their tension, fluid by its pressure."""
    seen = law.particles(F[None], F_dot[None])
    lattice, x = seen.F[0] @ seen.lattice, seen.position[0]
    shifts = [lattice @ (i, j) for i in range(TILES) for j in range(TILES)]
    first, second = x[seen.bonds[:, 0]], x[seen.bonds[:, 1]] + seen.bond_shift @ lattice.T
    walls = np.stack([first, second], axis=1)
    along = np.abs(np.linalg.solve(lattice, (second - first).T))  # (2, b) parts along the periods
    lines = [walls + shift for shift in shifts]
    for axis in (0, 1):  # the cells at the end of each axis get the walls of the next ones
        closing = walls[along[axis] < along[1 - axis]]
        steps = np.eye(2)[[axis, 1 - axis]]
        lines += [closing + lattice @ (TILES * steps[0] + k * steps[1]) for k in range(TILES)]
    place.add_collection(LineCollection(np.concatenate(lines), colors="#1b7837", linewidths=2.2))
    fluid = np.concatenate([x[~seen.is_wall] + shift for shift in shifts])
    pressure = np.tile(seen.pressure[0], len(shifts))
    dots = place.scatter(*fluid.T, c=pressure / 10.0, cmap="Blues", s=48.0, vmin=0.0,
                         edgecolor="0.5", linewidth=0.3)  # fmt: skip
    place.autoscale()
    place.set_aspect("equal")
    place.set_xticks([])
    place.set_yticks([])
    for side in place.spines.values():
        side.set_color("#d55e00")
    left, low = fluid.min(axis=0)
    place.plot([left, left + 10.0], [low - 9.0] * 2, color="black", linewidth=2.5)
    place.text(left + 5.0, low - 10.0, "10 µm", ha="center", va="top", fontsize=8)
    place.set_ylim(low - 15.0, None)
    place.set_xlabel("plant cells there: walls and fluid")
    place.figure.colorbar(dots, ax=place, label="pressure of the fluid (MPa)", shrink=0.8)


def main():
    """Run the bar by the cache and draw the frame with the most elements by RVEs."""
    law = RveLaw(CellParameters.preset("printed"))
    cached = CachedLaw(read_surrogate(ROOT / "training" / "bending-bar.h5"), law)
    bar = LoadCase(elements=(16, 16), body_force=(0.0, -0.45), duration=27.0)
    run = simulate(bar, cached)
    k = int((run.frames.source != 0).sum(axis=1).argmax())
    figure = Figure(figsize=(8.0, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    corners, by_rve = tissue(left, run, k)
    strain = np.abs(run.frames.F[k] - np.eye(2)).max(axis=(1, 2))
    shown = int(np.where(by_rve, strain, -1.0).argmax())
    cells(right, law, run.frames.F[k, shown], run.frames.F_dot[k, shown])
    pointer = ConnectionPatch(
        corners[shown].mean(axis=0), (0.0, 0.5), coordsA="data", coordsB="axes fraction",
        axesA=left, axesB=right, color="#d55e00", linewidth=1.0,
    )  # fmt: skip
    figure.add_artist(pointer)
    figure.savefig(ROOT / "docs" / "readme.png", dpi=300)
    print(f"{run.frames.t[k]:.1f} µs, {by_rve.sum()} of {len(by_rve)} elements by RVEs")


if __name__ == "__main__":
    main()

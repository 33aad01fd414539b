"""Pictures of RVEs: walls by stretch, fluid by pressure, at several times."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from surrofe2.report.figures import make_figure, write_png
from surrofe2.rve.particles import Particles

Array = NDArray[np.float64]

PANELS = 6
CLOCK = "t = {:.4g} µs"
_COPIES = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)])
_WALLS, _FLUID = "viridis", "Blues"


def write_particle_picture(
    path: Path, title: str, seen: Particles, t: Array, clock: str = CLOCK
) -> None:
    """Draw the RVE at six times from the first to the last of t (n,), as `clock` tells, as PNG."""
    chosen = np.unique(np.linspace(0, len(t) - 1, min(PANELS, len(t))).round().astype(int))
    columns = min(3, len(chosen))
    rows = -(-len(chosen) // columns)
    figure = make_figure([], (3.3 * columns + 1.6, 3.3 * rows + 0.6))
    places = figure.subplots(rows, columns, squeeze=False)
    window = _window(seen)
    for place, k in zip(places.flat, chosen, strict=False):
        drawn = _draw(place, seen, int(k), window)
        place.set_title(clock.format(t[k]), fontsize=9)
    for place in places.flat[len(chosen) :]:
        place.axis("off")
    _add_scales(figure, places.ravel().tolist(), drawn)
    figure.suptitle(title, fontsize=11)
    write_png(path, figure)


def _draw(
    place: Axes, seen: Particles, k: int, window: float
) -> tuple[LineCollection, PathCollection]:
    """The RVE with its neighbours in a window of half this width about its centre, µm."""
    lattice = seen.F[k] @ seen.lattice
    copies = _COPIES @ lattice.T
    walls = int(seen.is_wall.sum())
    x = seen.position[k]
    first = x[seen.bonds[:, 0]]
    second = x[seen.bonds[:, 1]] + seen.bond_shift @ lattice.T
    segments = np.stack([first, second], axis=1)[None] + copies[:, None, None]
    drawn_walls = LineCollection(
        [*segments.reshape(-1, 2, 2)],
        array=np.tile(seen.stretch[k], len(copies)),
        cmap=_WALLS,
        clim=(float(seen.stretch.min()), float(seen.stretch.max())),
        linewidths=2.2,
    )
    place.add_collection(drawn_walls)
    fluid = (x[walls:][None] + copies[:, None]).reshape(-1, 2)
    drawn_fluid = place.scatter(
        fluid[:, 0],
        fluid[:, 1],
        c=np.tile(seen.pressure[k], len(copies)),
        cmap=_FLUID,
        vmin=0.6 * float(seen.pressure.min()),
        vmax=float(seen.pressure.max()),
        s=14.0,
        edgecolors="0.5",
        linewidths=0.3,
    )
    centre = x[:walls].mean(axis=0) + 0.25 * lattice.sum(axis=1)
    place.set_xlim(centre[0] - window, centre[0] + window)
    place.set_ylim(centre[1] - window, centre[1] + window)
    place.set_aspect("equal")
    place.set_xticks([])
    place.set_yticks([])
    return drawn_walls, drawn_fluid


def _window(seen: Particles) -> float:
    """Half the width of what is shown: the RVE and a little of its neighbours, µm."""
    corners = np.einsum("nij,jk->nki", seen.F, seen.lattice)
    return 0.75 * float(abs(corners).sum(axis=1).max())


def _add_scales(
    figure: Figure, places: Sequence[Axes], drawn: tuple[LineCollection, PathCollection]
) -> None:
    walls, fluid = drawn
    figure.colorbar(fluid, ax=[*places], shrink=0.7, label="turgor, µN/µm")
    figure.colorbar(walls, ax=[*places], shrink=0.7, label="wall length / rest length, 1")
